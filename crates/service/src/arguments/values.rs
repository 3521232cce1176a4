//! What a value on the command line must be.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use echosplat_georeference::Datum;
use echosplat_model::glam::DVec3;
use echosplat_recording::export::Up;
use echosplat_simulator::{DiveKind, NoiseLevel};

use crate::clock;

pub(super) fn dive_kind() -> impl TypedValueParser<Value = DiveKind> {
    PossibleValuesParser::new(DiveKind::ALL.map(DiveKind::as_str))
        .try_map(|name| name.parse::<DiveKind>())
}

pub(super) fn noise_level() -> impl TypedValueParser<Value = NoiseLevel> {
    PossibleValuesParser::new(NoiseLevel::ALL.map(NoiseLevel::as_str))
        .try_map(|name| name.parse::<NoiseLevel>())
}

pub(super) fn up_axis() -> impl TypedValueParser<Value = Up> {
    PossibleValuesParser::new([Up::Z, Up::Y, Up::NegativeY].map(Up::name))
        .map(|name| Up::of(&name).expect("it is one of them"))
}

pub(super) fn datum() -> impl TypedValueParser<Value = Datum> {
    PossibleValuesParser::new(Datum::ALL.map(Datum::name)).try_map(|name| name.parse::<Datum>())
}

fn number(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .map_err(|_| "it must be a number".to_owned())
}

/// Days since 1970-01-01.
pub(super) fn day(text: &str) -> Result<i64, String> {
    let date: jiff::civil::Date = text
        .parse()
        .map_err(|_| "it must be a day, as in 2026-11-30".to_owned())?;
    Ok(clock::day_of(date))
}

pub(super) fn finite(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    match value.is_finite() {
        true => Ok(value),
        false => Err("it must be finite".to_owned()),
    }
}

pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    match value >= 0.0 {
        true => Ok(value),
        false => Err("it must be 0 or more".to_owned()),
    }
}

/// A number of more than 0.
///
/// # Errors
/// If it is none.
pub fn positive(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    match value > 0.0 {
        true => Ok(value),
        false => Err("it must be more than 0".to_owned()),
    }
}

pub(super) fn sweep(text: &str) -> Result<f64, String> {
    let value = positive(text)?;
    match value <= 360.0 {
        true => Ok(value),
        false => Err("it must be at most 360".to_owned()),
    }
}

/// World coordinates, metres.
pub(super) fn place(text: &str) -> Result<DVec3, String> {
    let wrong =
        || "it must be three numbers, east, north, up in metres, as in 1.5,-2,-3.25".to_owned();
    let numbers: Result<Vec<f64>, String> =
        text.split(',').map(|word| finite(word.trim())).collect();
    let numbers: [f64; 3] = numbers
        .map_err(|_| wrong())?
        .try_into()
        .map_err(|_| wrong())?;
    Ok(numbers.into())
}

pub(super) fn key_and_value(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((key, value)) if !key.is_empty() => Ok((key.to_owned(), value.to_owned())),
        _ => Err("it must read key=value, as in connect/endpoints=[\"tcp/10.0.0.2:7447\"]".into()),
    }
}
