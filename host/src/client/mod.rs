//! Client of the DMC60C protocol, generic over [`Bus`](crate::transport::Bus).
