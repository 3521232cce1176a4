//! `MAVLink` messages as JSON: what mavlink-server puts on the bus, what mavlink2rest sends, and what
//! wrapper packets of a `.svlog` hold.
//!
//! `{"header": {"system_id": 1, "component_id": 1, …}, "message": {"type": "ATTITUDE", …}}`; enums
//! are objects `{"type": "MAV_FRAME_LOCAL_NED"}`. mavlink-server writes JSON5, where numbers that
//! are not finite stand as `NaN` and `Infinity`.

use echosplat_model::glam::DVec3;
use mavlink::dialects::ardupilotmega::EkfStatusFlags;
use serde_json::{Map, Value};

use super::message::{
    Message, Odometry, Sender, Station, has_velocity, ned_from_frd, of_cmps, of_wxyz,
};
use super::origin::Fix;
use crate::fault::quoted;

/// Longest text read; an `ODOMETRY` with both covariances has some 1,500 bytes.
pub(crate) const MAX_JSON_BYTES: usize = 16 * 1024;

/// A message and who sent it, as far as the text says; `None` for one that is of no use here.
///
/// # Errors
/// What is wrong with the text.
pub(crate) fn parse(text: &[u8]) -> Result<Option<(Sender, Message)>, String> {
    if text.len() > MAX_JSON_BYTES {
        return Err(format!(
            "{} bytes; at most {MAX_JSON_BYTES} are read",
            text.len()
        ));
    }
    let document = document(text)?;
    let body = document.get("message").unwrap_or(&document);
    let name = body.get("type").and_then(Value::as_str);
    let name = name.ok_or("there is no message.type in it")?;
    let fields = body.as_object().map(|fields| Fields { name, fields });
    let message = fields.map_or(Ok(None), |fields| message(&fields))?;
    let header = |key| {
        document
            .get("header")
            .and_then(|header| header.get(key)?.as_u64())
    };
    let sender = Sender {
        system: header("system_id").unwrap_or(0) as u32,
        component: header("component_id").unwrap_or(0) as u8,
    };
    Ok(message.map(|message| (sender, message)))
}

fn document(text: &[u8]) -> Result<Value, String> {
    if let Ok(value) = serde_json::from_slice(text) {
        return Ok(value);
    }
    let text = std::str::from_utf8(text).map_err(|_| "it is no text".to_owned())?;
    json5::from_str(text).map_err(|reason| format!("it is no JSON: {reason}"))
}

fn message(fields: &Fields<'_>) -> Result<Option<Message>, String> {
    Ok(Some(match fields.name {
        "ATTITUDE" => Message::Attitude {
            boot_ms: fields.integer("time_boot_ms")?,
            ned_from_frd: ned_from_frd(
                fields.number("roll")?,
                fields.number("pitch")?,
                fields.number("yaw")?,
            ),
            is_quaternion: false,
        },
        "ATTITUDE_QUATERNION" => Message::Attitude {
            boot_ms: fields.integer("time_boot_ms")?,
            ned_from_frd: of_wxyz([
                fields.number("q1")?,
                fields.number("q2")?,
                fields.number("q3")?,
                fields.number("q4")?,
            ]),
            is_quaternion: true,
        },
        "LOCAL_POSITION_NED" => Message::Position {
            boot_ms: fields.integer("time_boot_ms")?,
            position_ned_m: fields.vector(["x", "y", "z"])?,
            velocity_ned_mps: fields.vector(["vx", "vy", "vz"])?,
        },
        "SYSTEM_TIME" => Message::SystemTime {
            unix_us: fields.integer("time_unix_usec")?,
            boot_ms: fields.integer("time_boot_ms")?,
        },
        "ODOMETRY" => Message::Odometry(Box::new(odometry(fields)?)),
        "HEARTBEAT" => Message::Heartbeat(Station::of_names(
            fields.name_of("autopilot")?,
            fields.name_of("mavtype")?,
        )),
        "GPS_GLOBAL_ORIGIN" => {
            Message::GlobalOrigin(fields.fix(["latitude", "longitude", "altitude"])?)
        }
        "GLOBAL_POSITION_INT" => Message::GlobalPosition {
            boot_ms: fields.integer("time_boot_ms")?,
            fix: fields.fix(["lat", "lon", "alt"])?,
            height_m: fields.number("relative_alt").unwrap_or(0.0) * 1e-3,
            velocity_ned_mps: fields
                .vector(["vx", "vy", "vz"])
                .map_or(DVec3::NAN, |cmps| of_cmps(cmps.to_array())),
        },
        "VFR_HUD" => return Ok(fields.number("alt").ok().map(Message::Height)),
        "EKF_STATUS_REPORT" => Message::EstimateStatus {
            has_velocity: fields.flags("flags").is_some_and(has_velocity),
        },
        "VISION_POSITION_DELTA" => Message::PositionDelta {
            time_us: fields.integer("time_usec")?,
            delta_us: fields.integer("time_delta_usec")?,
            moved_frd_m: DVec3::from_array(fields.numbers("position_delta")?),
            confidence: fields.number("confidence")?,
        },
        "VISION_SPEED_ESTIMATE" => Message::Speed {
            time_us: fields.integer("usec")?,
            velocity_mps: fields.vector(["x", "y", "z"])?,
        },
        _ => return Ok(None),
    }))
}

fn odometry(fields: &Fields<'_>) -> Result<Odometry, String> {
    Ok(Odometry {
        time_us: fields.integer("time_usec")?,
        frame: fields.frame("frame_id")?,
        child_frame: fields.frame("child_frame_id")?,
        position_m: fields.vector(["x", "y", "z"])?,
        frame_from_body: of_wxyz(fields.numbers("q")?),
        velocity_mps: fields.vector(["vx", "vy", "vz"]).unwrap_or(DVec3::NAN),
        covariance: fields.numbers("pose_covariance").unwrap_or([f64::NAN; 21]),
        reset_counter: fields.integer("reset_counter").unwrap_or(0),
        quality: fields.number("quality").map_or(0, |quality| quality as i64),
    })
}

/// The fields of one message.
struct Fields<'a> {
    name: &'a str,
    fields: &'a Map<String, Value>,
}

impl Fields<'_> {
    fn value(&self, key: &str) -> Result<&Value, String> {
        let found = self.fields.get(key);
        found.ok_or_else(|| format!("{} has no `{key}`", quoted(self.name)))
    }

    fn number(&self, key: &str) -> Result<f64, String> {
        let wrong = || format!("`{key}` of {} is no number", quoted(self.name));
        number(self.value(key)?).ok_or_else(wrong)
    }

    fn integer<T: TryFrom<u64>>(&self, key: &str) -> Result<T, String> {
        let found = self.value(key)?.as_u64().and_then(|n| n.try_into().ok());
        found.ok_or_else(|| format!("`{key}` of {} is out of range", quoted(self.name)))
    }

    /// Whole numbers of 1e-7 degrees, and of millimetres.
    fn fix(&self, keys: [&str; 3]) -> Result<Fix, String> {
        let [latitude_e7, longitude_e7, height_mm] = keys.map(|key| {
            let found = self.value(key)?.as_i64().and_then(|n| n.try_into().ok());
            found.ok_or_else(|| format!("`{key}` of {} is out of range", quoted(self.name)))
        });
        Ok(Fix {
            latitude_e7: latitude_e7?,
            longitude_e7: longitude_e7?,
            height_mm: height_mm?,
        })
    }

    fn vector(&self, keys: [&str; 3]) -> Result<DVec3, String> {
        let [x, y, z] = keys.map(|key| self.number(key));
        Ok(DVec3::new(x?, y?, z?))
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<[f64; N], String> {
        let list = self.value(key)?.as_array();
        let numbers: Option<Vec<f64>> = list.and_then(|list| list.iter().map(number).collect());
        let array = numbers.and_then(|numbers| numbers.try_into().ok());
        array.ok_or_else(|| format!("`{key}` of {} is no list of {N} numbers", quoted(self.name)))
    }

    /// An enum's value: its name, or an object with its name.
    fn name_of(&self, key: &str) -> Result<&str, String> {
        let value = self.value(key)?;
        let name = value.get("type").unwrap_or(value).as_str();
        name.ok_or_else(|| format!("`{key}` of {} is no name", quoted(self.name)))
    }

    /// Of `EKF_STATUS_REPORT`: a number, an object with one as `bits`, or names between bars.
    fn flags(&self, key: &str) -> Option<EkfStatusFlags> {
        let value = self.value(key).ok()?;
        if let Some(bits) = value.get("bits").unwrap_or(value).as_u64() {
            return Some(EkfStatusFlags::from_bits_truncate(bits as u16));
        }
        let names = value.as_str()?.split('|').map(str::trim);
        Some(names.filter_map(EkfStatusFlags::from_name).collect())
    }

    /// A `MAV_FRAME`: its number, its name, or an object with its name.
    fn frame(&self, key: &str) -> Result<u32, String> {
        let value = self.value(key)?;
        let name = value.get("type").unwrap_or(value);
        let of_name = name.as_str().and_then(frame_of_name);
        let of_number = || name.as_u64().and_then(|n| u32::try_from(n).ok());
        let found = of_name.or_else(of_number);
        found.ok_or_else(|| format!("`{key}` of {} is no known frame", quoted(self.name)))
    }
}

/// `null` is how plain JSON writes NaN.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Null => Some(f64::NAN),
        value => value.as_f64(),
    }
}

/// The frames that `ODOMETRY` is sent in, and their numbers.
#[expect(deprecated, reason = "older vehicles call the body's frame so")]
fn frame_of_name(name: &str) -> Option<u32> {
    use mavlink::dialects::ardupilotmega::MavFrame as F;
    let frame = match name {
        "MAV_FRAME_LOCAL_NED" => F::MAV_FRAME_LOCAL_NED,
        "MAV_FRAME_LOCAL_ENU" => F::MAV_FRAME_LOCAL_ENU,
        "MAV_FRAME_BODY_NED" => F::MAV_FRAME_BODY_NED,
        "MAV_FRAME_BODY_FRD" => F::MAV_FRAME_BODY_FRD,
        "MAV_FRAME_LOCAL_FRD" => F::MAV_FRAME_LOCAL_FRD,
        "MAV_FRAME_LOCAL_FLU" => F::MAV_FRAME_LOCAL_FLU,
        _ => return None,
    };
    Some(frame as u32)
}
