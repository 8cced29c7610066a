//! The body of `POST /api/sim/frames`.

use embedded_can::{ExtendedId, Id, StandardId};
use windlass_core::frame::Frame;

use super::http::Refusal;
use super::json::{Fields, required};

/// Reads a frame: `id` is required, `ext` and `rtr` are false and `data` is empty unless given; `dlc` is
/// for remote frames, else it may only repeat the number of bytes.
pub(super) fn parse(body: &[u8]) -> Result<Frame, Refusal> {
    let mut fields = Fields::parse(body)?;
    let extended = fields.boolean("ext")?.unwrap_or(false);
    let largest = if extended { 0x1FFF_FFFF } else { 0x7FF };
    let raw = fields.integer("id", 0..=largest)?;
    let data = fields.text("data")?.unwrap_or_default();
    let remote = fields.boolean("rtr")?.unwrap_or(false);
    let length = fields.integer("dlc", 0..=8)?;
    fields.finish()?;

    let id = identifier(required("id", raw)? as u32, extended)
        .ok_or_else(|| Refusal::bad_request("field \"id\" is no identifier"))?;
    let data = bytes_from_hex(&data).ok_or_else(|| {
        Refusal::bad_request("field \"data\" must be up to 8 bytes as pairs of hex digits")
    })?;
    let frame = match (remote, length.map(|length| length as usize)) {
        (true, _) if !data.is_empty() => {
            let reason = "field \"data\" must be empty in a remote frame";
            return Err(Refusal::bad_request(reason));
        }
        (true, length) => Frame::remote(id, length.unwrap_or(0)),
        (false, Some(length)) if length != data.len() => None,
        (false, _) => Frame::new(id, &data),
    };
    frame.ok_or_else(|| Refusal::bad_request("field \"dlc\" must be the number of data bytes"))
}

fn identifier(raw: u32, extended: bool) -> Option<Id> {
    if extended {
        ExtendedId::new(raw).map(Id::from)
    } else {
        StandardId::new(u16::try_from(raw).ok()?).map(Id::from)
    }
}

fn bytes_from_hex(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text
        .chars()
        .map(|digit| digit.to_digit(16).map(|value| value as u8))
        .collect::<Option<_>>()?;
    if !digits.len().is_multiple_of(2) || digits.len() > 16 {
        return None;
    }
    let pairs = digits.chunks_exact(2);
    Some(pairs.map(|pair| pair[0] << 4 | pair[1]).collect())
}
