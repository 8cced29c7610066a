//! Intel HEX, read into [`Memory`] and written from runs of bytes.

use ihex::{ReaderError, Record};

use super::memory::{Memory, MemoryError};

/// Longest file in bytes: [`super::memory::MOST_BYTES`] as HEX records of 16 bytes, and some.
pub const LONGEST_FILE: usize = 4 << 20;

/// Bytes of data in one record that is written.
const RECORD_DATA: usize = 32;

/// Why a HEX file cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HexError {
    /// The file is longer than [`LONGEST_FILE`].
    #[error("the HEX file is larger than {} MiB", LONGEST_FILE >> 20)]
    TooLong,
    /// Bytes that are no text.
    #[error("the HEX file has bytes that are no ASCII text (line {line})")]
    NotText {
        /// Line, from 1.
        line: usize,
    },
    /// A record is malformed.
    #[error("the HEX file is damaged in line {line}: {}", describe(.error))]
    Record {
        /// Line, from 1.
        line: usize,
        /// What is wrong with it.
        error: ReaderError,
    },
    /// A record's data wraps around the end of its 64 KiB segment.
    #[error("the HEX file's record in line {line} runs over the end of its 64 KiB segment")]
    Wrap {
        /// Line, from 1.
        line: usize,
    },
    /// The end-of-file record is missing.
    #[error("the HEX file is cut short: its end record is missing")]
    NoEnd,
    /// Something stands after the end-of-file record.
    #[error("the HEX file goes on after its end record (line {line})")]
    AfterEnd {
        /// Line, from 1.
        line: usize,
    },
    /// The file has no data.
    #[error("the HEX file holds no data")]
    NoData,
    /// The data cannot be placed in memory.
    #[error("the HEX file cannot be used: {0}")]
    Memory(#[from] MemoryError),
}

fn describe(error: &ReaderError) -> String {
    match error {
        ReaderError::MissingStartCode => "it does not begin with a colon".to_owned(),
        ReaderError::RecordTooShort => "the record is cut short".to_owned(),
        ReaderError::RecordTooLong => "the record is too long".to_owned(),
        ReaderError::RecordNotEvenLength => "half of a byte is missing".to_owned(),
        ReaderError::ContainsInvalidCharacters => "a letter is no hexadecimal digit".to_owned(),
        ReaderError::ChecksumMismatch(found, expected) => {
            format!("its checksum is {found:02X} and should be {expected:02X}")
        }
        ReaderError::PayloadLengthMismatch => "its length differs from the one it names".to_owned(),
        ReaderError::UnsupportedRecordType(kind) => format!("there is no record type {kind:02X}"),
        ReaderError::InvalidLengthForType => "its length does not fit its type".to_owned(),
    }
}

/// True if a file begins like a HEX file.
#[must_use]
pub fn looks_like_hex(file: &[u8]) -> bool {
    file.trim_ascii_start().first() == Some(&b':')
}

/// Reads a HEX file. Every line is one record; empty lines and spaces around records are allowed.
///
/// # Errors
/// Anything malformed, as [`HexError`] tells.
pub fn read(file: &[u8]) -> Result<Memory, HexError> {
    if file.len() > LONGEST_FILE {
        return Err(HexError::TooLong);
    }
    let mut memory = Memory::default();
    let mut base = 0_u32;
    let mut ended = false;
    for (index, bytes) in file.split(|byte| *byte == b'\n').enumerate() {
        let line = index + 1;
        let bytes = bytes.trim_ascii();
        if bytes.is_empty() {
            continue;
        }
        if ended {
            return Err(HexError::AfterEnd { line });
        }
        let text = match std::str::from_utf8(bytes) {
            Ok(text) if text.is_ascii() => text,
            _ => return Err(HexError::NotText { line }),
        };
        match Record::from_record_string(text).map_err(|error| HexError::Record { line, error })? {
            Record::Data { offset, value } => {
                if usize::from(offset) + value.len() > 1 << 16 {
                    return Err(HexError::Wrap { line });
                }
                let address = base
                    .checked_add(u32::from(offset))
                    .ok_or(MemoryError::BeyondEnd(base))?;
                memory.add(address, &value)?;
            }
            Record::ExtendedSegmentAddress(segment) => base = u32::from(segment) << 4,
            Record::ExtendedLinearAddress(upper) => base = u32::from(upper) << 16,
            // Where a program would start is not of interest: the vector table tells.
            Record::StartSegmentAddress { .. } | Record::StartLinearAddress(_) => {}
            Record::EndOfFile => ended = true,
        }
    }
    if !ended {
        return Err(HexError::NoEnd);
    }
    let memory = memory.finish()?;
    if memory.lowest().is_none() {
        return Err(HexError::NoData);
    }
    Ok(memory)
}

/// Writes memory as a HEX file.
#[must_use]
pub fn write(memory: &Memory) -> String {
    let mut text = String::new();
    let mut line = |record: Record| {
        // Only data longer than 255 bytes could be refused.
        if let Ok(record) = record.to_record_string() {
            text.push_str(&record);
            text.push('\n');
        }
    };
    let mut upper = None;
    for run in memory.runs() {
        let mut address = run.address;
        let mut rest = run.bytes.as_slice();
        while !rest.is_empty() {
            let [high, low] = [(address >> 16) as u16, address as u16];
            if upper != Some(high) {
                upper = Some(high);
                line(Record::ExtendedLinearAddress(high));
            }
            let room = (1_usize << 16) - usize::from(low);
            let (value, after) = rest.split_at(rest.len().min(RECORD_DATA).min(room));
            line(Record::Data {
                offset: low,
                value: value.to_vec(),
            });
            // A run ends at the last address at most, so only an exhausted one wraps.
            address = address.wrapping_add(value.len() as u32);
            rest = after;
        }
    }
    line(Record::EndOfFile);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_RUNS: &str =
        ":020000040802F0\n:0401000001020304F1\n:020000040000FA\n:01000000AA55\n:00000001FF\n";

    fn error(text: &str) -> HexError {
        read(text.as_bytes()).unwrap_err()
    }

    #[test]
    fn records_are_placed_at_their_addresses() {
        let memory = read(TWO_RUNS.as_bytes()).unwrap();
        let runs: Vec<(u32, &[u8])> = memory
            .runs()
            .iter()
            .map(|run| (run.address, run.bytes.as_slice()))
            .collect();
        assert_eq!(runs, [(0, &[0xAA][..]), (0x0802_0100, &[1, 2, 3, 4])]);
        let windows = TWO_RUNS.replace('\n', " \r\n\r\n");
        assert_eq!(read(windows.as_bytes()).unwrap(), memory);
        assert_eq!(read(write(&memory).as_bytes()).unwrap(), memory);
    }

    #[test]
    fn what_is_written_is_read_again_over_segment_ends() {
        let mut memory = Memory::default();
        memory.add(0x0801_FFF1, &[7; 100]).unwrap();
        memory.add(0xFFFF_FFFE, &[1, 2]).unwrap();
        let memory = memory.finish().unwrap();
        assert_eq!(read(write(&memory).as_bytes()).unwrap(), memory);
    }

    #[test]
    fn segments_of_16_bits_count_too() {
        let memory = read(b":020000021000EC\n:01000000AA55\n:00000001FF\n").unwrap();
        assert_eq!(memory.lowest(), Some(0x1_0000));
    }

    #[test]
    fn every_kind_of_damage_has_its_own_message() {
        let errors = [
            error(&TWO_RUNS.replace(":04", "04")),
            error(":00\n"),
            error(":0401000001020304F10\n:00000001FF\n"),
            error(&TWO_RUNS.replace("F1", "FG")),
            error(&TWO_RUNS.replace("F1", "F2")),
            error(":0501000001020304F0\n"),
            error(":00000006FA\n"),
            error(":0100000400FB\n"),
            error(&TWO_RUNS.replace(":00000001FF\n", "")),
            error(&format!("{TWO_RUNS}:00000001FF\n")),
            error(":00000001FF\n"),
            error(":02FFFF000102FD\n:00000001FF\n").clone(),
            error(":0100000001FE\n:0100000001FE\n:00000001FF\n"),
            error(":01\u{e9}"),
            read(&vec![b':'; LONGEST_FILE + 1]).unwrap_err(),
        ];
        let texts: std::collections::BTreeSet<String> = errors
            .iter()
            .map(|error| error.to_string().replace(char::is_numeric, ""))
            .collect();
        assert_eq!(texts.len(), errors.len(), "{texts:#?}");
        assert!(
            matches!(errors[11], HexError::Wrap { line: 1 }),
            "{:?}",
            errors[11]
        );
    }
}
