//! Definitions by EPSG code: those that every build knows, and with the feature `epsg` all others.

/// How a code is computed, and what a file says of it.
pub(crate) struct Definition {
    /// Parameters as PROJ reads them.
    pub(crate) proj: String,
    /// Well-known text, first version.
    pub(crate) wkt: String,
}

const WGS_84: &str = r#"GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]]"#;
const ETRS89: &str = r#"GEOGCS["ETRS89",DATUM["European_Terrestrial_Reference_System_1989",SPHEROID["GRS 1980",6378137,298.257222101,AUTHORITY["EPSG","7019"]],AUTHORITY["EPSG","6258"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4258"]]"#;
const METRE: &str = r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]]"#;

/// What this build knows of the code.
pub(crate) fn definition(code: u16) -> Option<Definition> {
    let found = |proj: String, wkt: String| Some(Definition { proj, wkt });
    match code {
        4326 => found("+proj=longlat +datum=WGS84 +no_defs".into(), WGS_84.into()),
        4258 => found("+proj=longlat +ellps=GRS80 +no_defs".into(), ETRS89.into()),
        32601..=32660 => {
            let zone = code - 32600;
            found(
                format!("+proj=utm +zone={zone} +datum=WGS84 +units=m +no_defs"),
                utm(WGS_84, "WGS 84", zone, true, code),
            )
        }
        32701..=32760 => {
            let zone = code - 32700;
            found(
                format!("+proj=utm +zone={zone} +south +datum=WGS84 +units=m +no_defs"),
                utm(WGS_84, "WGS 84", zone, false, code),
            )
        }
        25828..=25838 => {
            let zone = code - 25800;
            found(
                format!("+proj=utm +zone={zone} +ellps=GRS80 +units=m +no_defs"),
                utm(ETRS89, "ETRS89", zone, true, code),
            )
        }
        5041 => found(polar(90), polar_wkt(90, "North", code)),
        5042 => found(polar(-90), polar_wkt(-90, "South", code)),
        _ => registered(code),
    }
}

fn utm(geographic: &str, name: &str, zone: u16, is_north: bool, code: u16) -> String {
    let (letter, northing) = match is_north {
        true => ("N", 0),
        false => ("S", 10_000_000),
    };
    let meridian_deg = 6 * i32::from(zone) - 183;
    format!(
        r#"PROJCS["{name} / UTM zone {zone}{letter}",{geographic},PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",{meridian_deg}],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",{northing}],{METRE},AXIS["Easting",EAST],AXIS["Northing",NORTH],AUTHORITY["EPSG","{code}"]]"#
    )
}

fn polar(latitude_deg: i32) -> String {
    format!(
        "+proj=stere +lat_0={latitude_deg} +lon_0=0 +k=0.994 +x_0=2000000 +y_0=2000000 +datum=WGS84 +units=m +no_defs"
    )
}

fn polar_wkt(latitude_deg: i32, name: &str, code: u16) -> String {
    format!(
        r#"PROJCS["WGS 84 / UPS {name} (E,N)",{WGS_84},PROJECTION["Polar_Stereographic"],PARAMETER["latitude_of_origin",{latitude_deg}],PARAMETER["central_meridian",0],PARAMETER["scale_factor",0.994],PARAMETER["false_easting",2000000],PARAMETER["false_northing",2000000],{METRE},AUTHORITY["EPSG","{code}"]]"#
    )
}

#[cfg(feature = "epsg")]
fn registered(code: u16) -> Option<Definition> {
    let found = crs_definitions::from_code(code)?;
    Some(Definition {
        proj: found.proj4.to_owned(),
        wkt: found.wkt.to_owned(),
    })
}

#[cfg(not(feature = "epsg"))]
fn registered(_code: u16) -> Option<Definition> {
    None
}
