//! `cargo xtask log`: decodes the log of an image.

use std::fs;
use std::io::{self, Read};
use std::path::Path;

use defmt_decoder::{DecodeError, Table};

use crate::error::Error;

/// Prints a line for each frame on standard input until its end.
pub(crate) fn run(elf: &Path) -> Result<(), Error> {
    let bytes = fs::read(elf).map_err(|cause| Error::File {
        path: elf.to_owned(),
        cause,
    })?;
    let table = Table::parse(&bytes)
        .map_err(|error| error.to_string())
        .and_then(|table| table.ok_or_else(|| "it was built without a log".to_owned()))
        .map_err(|what| Error::Image {
            path: elf.to_owned(),
            what,
        })?;
    let mut decoder = table.new_stream_decoder();
    let mut part = [0; 1024];
    loop {
        let length = io::stdin().read(&mut part).map_err(|cause| Error::File {
            path: "standard input".into(),
            cause,
        })?;
        let Some(received) = part.get(..length).filter(|part| !part.is_empty()) else {
            return Ok(());
        };
        decoder.received(received);
        loop {
            match decoder.decode() {
                Ok(frame) => println!("{}", frame.display(false)),
                Err(DecodeError::UnexpectedEof) => break,
                // Other text of the console, or a frame that was cut: the next one is found by itself.
                Err(DecodeError::Malformed) => {}
            }
        }
    }
}
