//! Firmware for real microcontrollers. Nothing is here yet: the core runs on the bench only.
