//! Reads the JSON objects of requests strictly: whatever is not understood is refused by name.

use std::ops::RangeInclusive;

use serde_json::{Map, Value};

use super::http::Refusal;

/// The fields of a request's body. Each is taken once; [`Fields::finish`] refuses what is left.
pub(super) struct Fields {
    map: Map<String, Value>,
    known: Vec<&'static str>,
}

impl Fields {
    /// The body must be one JSON object.
    pub(super) fn parse(body: &[u8]) -> Result<Self, Refusal> {
        match serde_json::from_slice(body) {
            Ok(Value::Object(map)) => Ok(Self {
                map,
                known: Vec::new(),
            }),
            Ok(other) => Err(Refusal::bad_request(format!(
                "the body must be a JSON object, not {}",
                kind(&other)
            ))),
            Err(error) => Err(Refusal::bad_request(format!(
                "the body is no JSON: {error}"
            ))),
        }
    }

    /// A field that is true or false.
    pub(super) fn boolean(&mut self, name: &'static str) -> Result<Option<bool>, Refusal> {
        self.take(name, |value| boolean(&value))
    }

    /// As [`Fields::boolean`], but `null` is allowed and gives `Some(None)`.
    pub(super) fn boolean_or_null(
        &mut self,
        name: &'static str,
    ) -> Result<Option<Option<bool>>, Refusal> {
        self.take(name, |value| or_null(&value, boolean))
    }

    /// A field that is a number within `range`; messages name its `unit`.
    pub(super) fn number(
        &mut self,
        name: &'static str,
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Result<Option<f64>, Refusal> {
        self.take(name, |value| number(&value, &range, unit))
    }

    /// As [`Fields::number`], but `null` is allowed and gives `Some(None)`.
    pub(super) fn number_or_null(
        &mut self,
        name: &'static str,
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Result<Option<Option<f64>>, Refusal> {
        self.take(name, |value| {
            or_null(&value, |value| number(value, &range, unit))
        })
    }

    /// A field that is a whole number within `range`.
    pub(super) fn integer(
        &mut self,
        name: &'static str,
        range: RangeInclusive<u64>,
    ) -> Result<Option<u64>, Refusal> {
        self.take(name, |value| integer(&value, &range))
    }

    /// As [`Fields::integer`], but `null` is allowed and gives `Some(None)`.
    pub(super) fn integer_or_null(
        &mut self,
        name: &'static str,
        range: RangeInclusive<u64>,
    ) -> Result<Option<Option<u64>>, Refusal> {
        self.take(name, |value| {
            or_null(&value, |value| integer(value, &range))
        })
    }

    /// A field that is a text.
    pub(super) fn text(&mut self, name: &'static str) -> Result<Option<String>, Refusal> {
        self.take(name, |value| match value {
            Value::String(text) => Ok(text),
            other => Err(format!("must be a text, not {}", kind(&other))),
        })
    }

    /// Refuses fields that nobody asked for.
    pub(super) fn finish(self) -> Result<(), Refusal> {
        match self.map.keys().next() {
            None => Ok(()),
            Some(name) => Err(Refusal::bad_request(format!(
                "unknown field \"{name}\"; known: {}",
                self.known.join(", ")
            ))),
        }
    }

    fn take<T>(
        &mut self,
        name: &'static str,
        read: impl FnOnce(Value) -> Result<T, String>,
    ) -> Result<Option<T>, Refusal> {
        self.known.push(name);
        self.map
            .remove(name)
            .map(read)
            .transpose()
            .map_err(|reason| Refusal::bad_request(format!("field \"{name}\" {reason}")))
    }
}

/// Refuses a request that lacks a field it needs.
pub(super) fn required<T>(name: &str, value: Option<T>) -> Result<T, Refusal> {
    value.ok_or_else(|| Refusal::bad_request(format!("field \"{name}\" is missing")))
}

fn or_null<T>(
    value: &Value,
    read: impl FnOnce(&Value) -> Result<T, String>,
) -> Result<Option<T>, String> {
    match value {
        Value::Null => Ok(None),
        value => read(value).map(Some),
    }
}

fn boolean(value: &Value) -> Result<bool, String> {
    match value {
        Value::Bool(value) => Ok(*value),
        other => Err(format!("must be true or false, not {}", kind(other))),
    }
}

fn number(value: &Value, range: &RangeInclusive<f64>, unit: &str) -> Result<f64, String> {
    let (low, high) = (range.start(), range.end());
    match value.as_f64() {
        Some(number) if range.contains(&number) => Ok(number),
        Some(number) => Err(format!("is {number}, outside {low} to {high} {unit}")),
        None => Err(format!("must be a number, not {}", kind(value))),
    }
}

fn integer(value: &Value, range: &RangeInclusive<u64>) -> Result<u64, String> {
    let (low, high) = (range.start(), range.end());
    match value {
        Value::Number(number) => match number.as_u64() {
            Some(number) if range.contains(&number) => Ok(number),
            _ => Err(format!(
                "is {number}, not a whole number from {low} to {high}"
            )),
        },
        other => Err(format!("must be a whole number, not {}", kind(other))),
    }
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a boolean",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "an array",
        Value::Object(_) => "an object",
    }
}
