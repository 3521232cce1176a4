//! Infinite errors in JSON: `null`, both ways. For `#[serde(with = …)]`.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// # Errors
/// Of the serializer.
pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    value.is_finite().then_some(*value).serialize(serializer)
}

/// # Errors
/// Of the deserializer.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let value = Option::<f64>::deserialize(deserializer)?;
    Ok(value.unwrap_or(f64::INFINITY))
}
