//! NMEA 0183 text of a satellite receiver: GGA, RMC, HDT and VTG, each with its checksum.
//!
//! Format: IEC 61162-1. A sentence without a checksum counts as cut. What is no sentence is refused in words, other sentences are
//! passed over. Nothing is allocated but those words.

use echosplat_model::Timestamp;

use crate::fix::{Fix, Heard, USUAL_SIGMA_M, sigma_of};
use crate::{Datum, Place};

/// Bytes; the standard has 82, and some receivers write longer ones.
const LONGEST_SENTENCE: usize = 128;
/// Most sentences of one piece of text that are looked at; a packet has a few.
const MOST_SENTENCES: usize = 256;
/// RMC gives fixes where so many of them came without a GGA, which tells more.
const RMC_ALONE: u32 = 3;
/// Seconds.
const DAY_S: f64 = 86_400.0;

/// What one sentence says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sentence {
    /// GGA or RMC with a fix.
    Fix(NmeaFix),
    /// GGA of quality 0, RMC that is void, and fixes that are reckoned, typed in or simulated.
    NoFix {
        /// Of the day, UTC, seconds.
        of_day_s: Option<f64>,
    },
    /// HDT: where the bow points, degrees from true north.
    Heading(f64),
    /// VTG: where it moves, which is no heading.
    Course,
    /// HDG or HDM: by a magnetic compass.
    MagneticHeading,
    /// Any other.
    Other,
}

/// A fix as GGA or RMC tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NmeaFix {
    /// Of the day, UTC, seconds.
    pub of_day_s: Option<f64>,
    /// Its height is over mean sea level, or 0.
    pub place: Place,
    /// Whether the height was told.
    pub has_height: bool,
    /// Height of the geoid over the ellipsoid, metres.
    pub separation_m: Option<f64>,
    /// One sigma along one axis, metres, by the fix's quality.
    pub sigma_m: f64,
    /// GGA, which tells more than RMC.
    pub is_gga: bool,
}

/// Why a line is no sentence.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NmeaError {
    /// Not text.
    #[error("NMEA: bytes that are no text; a sentence reads $GPGGA,…*47")]
    Binary,
    /// Text without a beginning.
    #[error("NMEA: `{0}` does not begin with $ and a name; a sentence reads $GPGGA,…*47")]
    NoSentence(String),
    /// Too long.
    #[error("NMEA: a sentence of {0} bytes; at most {LONGEST_SENTENCE} are read")]
    Long(usize),
    /// Its end is missing.
    #[error("NMEA: `{0}` is cut: its checksum, * and two hexadecimal digits, is missing")]
    Cut(String),
    /// Damaged on its way.
    #[error(
        "NMEA: `{text}` says checksum {said:02X} and has {found:02X}: it was damaged on its way"
    )]
    Checksum {
        /// The sentence.
        text: String,
        /// By its own word.
        said: u8,
        /// Of its bytes.
        found: u8,
    },
    /// A field is no number, or none that it can be.
    #[error("NMEA: `{text}`: {why}")]
    Field {
        /// The sentence.
        text: String,
        /// What is wrong, and what would be right.
        why: String,
    },
}

/// Reads one line, with or without its end.
///
/// # Errors
/// Says what is wrong with it.
pub fn parse(line: &[u8]) -> Result<Sentence, NmeaError> {
    let line = line.trim_ascii();
    if line.len() > LONGEST_SENTENCE {
        return Err(NmeaError::Long(line.len()));
    }
    let text = std::str::from_utf8(line).map_err(|_| NmeaError::Binary)?;
    if !text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        return Err(NmeaError::Binary);
    }
    if text.starts_with('!') {
        // AIS of other ships.
        return Ok(Sentence::Other);
    }
    // A tag block may go before.
    let (_, body) = text
        .split_once('$')
        .ok_or_else(|| NmeaError::NoSentence(text.to_owned()))?;
    let (body, said) = body
        .rsplit_once('*')
        .ok_or_else(|| NmeaError::Cut(text.to_owned()))?;
    let is_hex = said.len() == 2 && said.bytes().all(|byte| byte.is_ascii_hexdigit());
    let said = Some(said).filter(|_| is_hex);
    let said = said.and_then(|said| u8::from_str_radix(said, 16).ok());
    let said = said.ok_or_else(|| NmeaError::Cut(text.to_owned()))?;
    let found = body.bytes().fold(0, |sum, byte| sum ^ byte);
    if said != found {
        let text = text.to_owned();
        return Err(NmeaError::Checksum { text, said, found });
    }
    let fields = Fields(body);
    // Two letters of the talker, three of what it says; P begins a maker's own.
    let name = fields.at(0);
    let kind = name.get(2..).filter(|_| name.len() == 5);
    let read = match kind {
        Some("GGA") => gga(fields),
        Some("RMC") => rmc(fields),
        Some("HDT") => hdt(fields),
        Some("VTG") => Ok(Sentence::Course),
        Some("HDG" | "HDM") => Ok(Sentence::MagneticHeading),
        _ => Ok(Sentence::Other),
    };
    read.map_err(|why| NmeaError::Field {
        text: text.to_owned(),
        why,
    })
}

/// The words between commas; empty beyond the last.
#[derive(Clone, Copy)]
struct Fields<'a>(&'a str);

impl<'a> Fields<'a> {
    fn at(self, index: usize) -> &'a str {
        self.0.split(',').nth(index).unwrap_or_default().trim()
    }

    /// `None` where it is empty.
    fn number(self, index: usize, name: &str) -> Result<Option<f64>, String> {
        let text = self.at(index);
        if text.is_empty() {
            return Ok(None);
        }
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        number
            .map(Some)
            .ok_or_else(|| format!("{name} `{text}` is no number"))
    }

    /// Degrees, of a field of degrees and minutes and the one behind it.
    fn degrees(
        self,
        index: usize,
        (name, digits): (&str, usize),
        ends: [&str; 2],
    ) -> Result<f64, String> {
        let (text, end) = (self.at(index), self.at(index + 1));
        let form = || {
            format!(
                "{name} `{text},{end}` is no degrees and minutes, as in {}",
                ends[0]
            )
        };
        let point = text.find('.').unwrap_or(text.len());
        let is_digits = text
            .bytes()
            .all(|byte| byte.is_ascii_digit() || byte == b'.');
        if !is_digits || point != digits + 2 {
            return Err(form());
        }
        let (degrees, minutes) = text.split_at(digits);
        let degrees: f64 = degrees.parse().map_err(|_| form())?;
        let minutes: f64 = minutes.parse().map_err(|_| form())?;
        if !(minutes < 60.0) {
            return Err(form());
        }
        let sign = match end {
            "N" | "E" => 1.0,
            "S" | "W" => -1.0,
            _ => return Err(form()),
        };
        let is_fitting = ends[1].contains(end);
        match is_fitting {
            true => Ok(sign * (degrees + minutes / 60.0)),
            false => Err(form()),
        }
    }

    fn place(self, index: usize, height_m: f64) -> Result<Place, String> {
        let latitude = self.degrees(index, ("latitude", 2), ["6010.2,N", "NS"])?;
        let longitude = self.degrees(index + 2, ("longitude", 3), ["02456.4,E", "EW"])?;
        Place::new(latitude, longitude, height_m).map_err(|error| error.to_string())
    }

    /// Seconds of the day, of hours, minutes and seconds.
    fn of_day_s(self, index: usize) -> Option<f64> {
        let text = self.at(index);
        let part = |from: usize, to: usize| text.get(from..to)?.parse::<u32>().ok().map(f64::from);
        let seconds: f64 = text.get(4..)?.parse().ok()?;
        let of_day_s = part(0, 2)? * 3600.0 + part(2, 4)? * 60.0 + seconds;
        (0.0..=DAY_S).contains(&of_day_s).then_some(of_day_s)
    }
}

/// Metres for each quality of GGA; `None` where satellites did not tell it.
fn sigma_of_quality(quality: &str, hdop: Option<f64>) -> Option<f64> {
    let spread = hdop.filter(|hdop| *hdop > 0.0).unwrap_or(1.0);
    Some(match quality {
        "1" | "3" => sigma_of(Some(USUAL_SIGMA_M * spread)),
        // Differential.
        "2" | "9" => sigma_of(Some(spread)),
        // Carrier phase, fixed and floating.
        "4" => 0.05,
        "5" => 0.5,
        // None, or reckoned, typed in, simulated.
        _ => return None,
    })
}

fn gga(fields: Fields<'_>) -> Result<Sentence, String> {
    let of_day_s = fields.of_day_s(1);
    let hdop = fields.number(8, "HDOP")?;
    let Some(sigma_m) = sigma_of_quality(fields.at(6), hdop) else {
        return Ok(Sentence::NoFix { of_day_s });
    };
    let height_m = fields.number(9, "height")?;
    Ok(Sentence::Fix(NmeaFix {
        of_day_s,
        place: fields.place(2, height_m.unwrap_or(0.0))?,
        has_height: height_m.is_some(),
        separation_m: fields.number(11, "geoid separation")?,
        sigma_m,
        is_gga: true,
    }))
}

fn rmc(fields: Fields<'_>) -> Result<Sentence, String> {
    let of_day_s = fields.of_day_s(1);
    // Behind the magnetic variation newer receivers say how the fix was made: not, or reckoned, typed in, simulated.
    let is_made_up = ["N", "E", "M", "S"].contains(&fields.at(12));
    if fields.at(2) != "A" || is_made_up {
        return Ok(Sentence::NoFix { of_day_s });
    }
    Ok(Sentence::Fix(NmeaFix {
        of_day_s,
        place: fields.place(3, 0.0)?,
        has_height: false,
        separation_m: None,
        sigma_m: USUAL_SIGMA_M,
        is_gga: false,
    }))
}

fn hdt(fields: Fields<'_>) -> Result<Sentence, String> {
    match fields.number(1, "heading")? {
        None => Ok(Sentence::Other),
        Some(heading) if (0.0..=360.0).contains(&heading) => Ok(Sentence::Heading(heading)),
        Some(heading) => Err(format!(
            "a heading of {heading} degrees: it must be within 0 to 360"
        )),
    }
}

/// How many sentences of which kind came.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct NmeaCounters {
    /// With a fix.
    pub fixes: u64,
    /// That say that there is no fix.
    pub no_fix: u64,
    /// With a true heading.
    pub headings: u64,
    /// With a magnetic heading, which is not used.
    pub magnetic_headings: u64,
    /// Cut, damaged, or with a number that cannot be.
    pub refused: u64,
    /// Others, passed over.
    pub others: u64,
    /// What was wrong with the first refused.
    pub first_fault: Option<String>,
}

/// The sentences of one receiver, one after another.
#[derive(Debug, Clone, Default)]
pub struct NmeaReceiver {
    counters: NmeaCounters,
    rmc_since_gga: u32,
    /// Of the newest time of day, and days that went by.
    of_day_s: Option<f64>,
    days: f64,
}

impl NmeaReceiver {
    /// Takes text, as of a packet or datagram; `take` gets what it tells, with the receiver's time in seconds since
    /// the day of its first sentence began. What lacks a time has that of the sentence before, and before the first none.
    pub fn take(&mut self, text: &[u8], mut take: impl FnMut(Told, Option<f64>)) {
        let lines = text.split(|byte| matches!(byte, b'\r' | b'\n' | 0));
        let lines = lines.filter(|line| !line.trim_ascii().is_empty());
        for line in lines.take(MOST_SENTENCES) {
            match parse(line) {
                Ok(sentence) => {
                    if let Some(told) = self.told(sentence) {
                        let now_s = self.of_day_s.map(|of_day_s| self.days * DAY_S + of_day_s);
                        take(told, now_s);
                    }
                }
                Err(error) => {
                    self.counters.refused += 1;
                    self.counters
                        .first_fault
                        .get_or_insert_with(|| error.to_string());
                }
            }
        }
    }

    /// How many came.
    #[must_use]
    pub fn counters(&self) -> &NmeaCounters {
        &self.counters
    }

    fn told(&mut self, sentence: Sentence) -> Option<Told> {
        let counters = &mut self.counters;
        match sentence {
            Sentence::Fix(fix) => {
                counters.fixes += 1;
                self.is_at(fix.of_day_s);
                self.rmc_since_gga = match fix.is_gga {
                    true => 0,
                    false => self.rmc_since_gga.saturating_add(1),
                };
                let is_taken = fix.is_gga || self.rmc_since_gga >= RMC_ALONE;
                is_taken.then_some(Told::Fix(fix))
            }
            Sentence::NoFix { of_day_s } => {
                counters.no_fix += 1;
                self.is_at(of_day_s);
                None
            }
            Sentence::Heading(heading_deg) => {
                counters.headings += 1;
                Some(Told::Heading(heading_deg))
            }
            Sentence::MagneticHeading => {
                counters.magnetic_headings += 1;
                None
            }
            Sentence::Course | Sentence::Other => {
                counters.others += 1;
                None
            }
        }
    }

    fn is_at(&mut self, of_day_s: Option<f64>) {
        let Some(of_day_s) = of_day_s else { return };
        let went_back_s = self.of_day_s.map_or(0.0, |before| before - of_day_s);
        // Midnight, and not a sentence that came late.
        if went_back_s > 0.5 * DAY_S {
            self.days += 1.0;
        }
        self.of_day_s = Some(of_day_s);
    }
}

/// What a sentence told that is used, without its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Told {
    /// A fix.
    Fix(NmeaFix),
    /// Where the bow points, degrees from true north.
    Heading(f64),
}

impl Told {
    /// At this time.
    #[must_use]
    pub fn at(self, time: Timestamp) -> Heard {
        match self {
            Self::Heading(heading_deg) => Heard::Heading { time, heading_deg },
            Self::Fix(fix) => Heard::Fix(Fix {
                time,
                place: fix.place,
                datum: fix.has_height.then_some(Datum::MeanSea),
                separation_m: fix.separation_m,
                sigma_m: fix.sigma_m,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_checksum(body: &str) -> String {
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        format!("${body}*{sum:02X}\r\n")
    }

    fn read(body: &str) -> Result<Sentence, NmeaError> {
        parse(with_checksum(body).as_bytes())
    }

    #[test]
    fn sentences_of_receivers_are_read() {
        // From the sources of gpsd and of u-blox' interface description.
        let gga = "$GPGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01,499.6,M,48.0,M,,*5B";
        let Sentence::Fix(fix) = parse(gga.as_bytes()).unwrap() else {
            panic!("a fix")
        };
        assert!((fix.place.latitude_deg - 47.285_233_166_7).abs() < 1e-9);
        assert!((fix.place.longitude_deg - 8.565_265).abs() < 1e-9);
        assert!((fix.place.height_m - 499.6).abs() < 1e-9 && fix.has_height);
        assert_eq!(
            (fix.separation_m, fix.of_day_s),
            (Some(48.0), Some(34_045.0))
        );
        let rmc = "$GPRMC,083559.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A*57";
        let Sentence::Fix(fix) = parse(rmc.as_bytes()).unwrap() else {
            panic!("a fix")
        };
        assert!(!fix.is_gga && !fix.has_height);
        assert_eq!(read("HEHDT,274.07,T"), Ok(Sentence::Heading(274.07)));
        assert_eq!(
            read("GPVTG,77.52,T,,M,0.004,N,0.008,K,A"),
            Ok(Sentence::Course)
        );
        assert_eq!(
            read("HCHDG,98.3,0.0,E,12.6,W"),
            Ok(Sentence::MagneticHeading)
        );
        let south_west = read("GNGGA,000000,3351.6,S,00000.6,W,4,12,0.5,1.0,M,,M,,").unwrap();
        let Sentence::Fix(fix) = south_west else {
            panic!("a fix")
        };
        assert!((fix.place.latitude_deg + 33.86).abs() < 1e-9);
        assert!((fix.place.longitude_deg + 0.01).abs() < 1e-9);
        assert!(fix.sigma_m < 0.1, "carrier phase");
        for other in [
            "GPGSV,1,1,00",
            "PUBX,00",
            "GPZDA,201530.00,04,07,2002,00,00",
            "",
            "GP",
        ] {
            assert_eq!(read(other), Ok(Sentence::Other), "{other}");
        }
        assert_eq!(
            parse(b"!AIVDM,1,1,,A,15M67N0P01G?Uf6E`FepT@3n00Sa,0*73"),
            Ok(Sentence::Other)
        );
        let tagged = format!("\\s:GP01,c:1714564800*2A\\{}", with_checksum("GPHDT,1.0,T"));
        assert_eq!(parse(tagged.as_bytes()), Ok(Sentence::Heading(1.0)));
    }

    #[test]
    fn what_has_no_fix_is_none() {
        for none in [
            "GPGGA,092725,,,,,0,00,99.9,,,,,,",
            "GPGGA,092725,4717.1,N,00833.9,E,6,08,1.0,4.0,M,48.0,M,,",
            "GPGGA,092725,4717.1,N,00833.9,E,8,08,1.0,4.0,M,48.0,M,,",
            "GPRMC,083559,V,4717.1,N,00833.9,E,0.0,77.5,091202,,,N",
            "GPRMC,083559,V,,,,,,,091202,,",
            "GPRMC,083559,A,4717.1,N,00833.9,E,0.0,77.5,091202,,,E",
        ] {
            let read = read(none);
            assert!(
                matches!(read, Ok(Sentence::NoFix { .. })),
                "{none}: {read:?}"
            );
        }
    }

    #[test]
    fn what_is_wrong_is_said() {
        let said = |line: &[u8]| parse(line).unwrap_err().to_string();
        let told = |body: &str| said(with_checksum(body).as_bytes());
        assert!(said(b"$GPHDT,1.0,T*00").contains("damaged"));
        assert!(said(b"$GPGGA,092725.00,4717.1").contains("cut"));
        assert!(said(b"$GPHDT,1.0,T*3").contains("cut"));
        assert!(said(b"$GPHDT,1.0,T*+3").contains("cut"));
        assert!(said(b"hello").contains("does not begin"));
        assert!(said(&[0x24, 0xff, 0x00, 0x80]).contains("no text"));
        assert!(said(&[b'$'; 4096]).contains("4096 bytes"));
        let north = told("GPGGA,1,9500.0,N,00833.9,E,1,08,1.0,4.0,M,48.0,M,,");
        assert!(north.contains("a latitude of 95 degrees"), "{north}");
        let height = told("GPGGA,1,4717.1,N,00833.9,E,1,08,1.0,NaN,M,48.0,M,,");
        assert!(height.contains("height `NaN` is no number"), "{height}");
        for wrong in [
            "GPGGA,1,NaN,N,00833.9,E,1,08,1.0,4.0,M,48.0,M,,",
            "GPGGA,1,4760.0,N,00833.9,E,1,08,1.0,4.0,M,48.0,M,,",
            "GPGGA,1,4717.1,E,00833.9,N,1,08,1.0,4.0,M,48.0,M,,",
            "GPGGA,1,4717.1,,00833.9,E,1,08,1.0,4.0,M,48.0,M,,",
            "GPGGA,1,,,,,1,08,1.0,4.0,M,48.0,M,,",
            "GPRMC,083559,A,4717.1,N,833.9,E,0.0,77.5,091202,,,A",
        ] {
            let told = told(wrong);
            assert!(told.contains("is no degrees and minutes"), "{told}");
        }
        assert!(told("GPHDT,361.0,T").contains("within 0 to 360"));
    }

    #[test]
    fn rmc_tells_where_no_gga_does_and_days_go_on() {
        let mut receiver = NmeaReceiver::default();
        let mut taken = Vec::new();
        let rmc = |time: &str| {
            with_checksum(&format!("GPRMC,{time},A,4717.1,N,00833.9,E,0,0,091202,,,A"))
        };
        let gga = with_checksum("GPGGA,235959,4717.1,N,00833.9,E,1,08,1.0,4.0,M,48.0,M,,");
        let text = [
            rmc("235958"),
            gga,
            rmc("235959"),
            with_checksum("GPHDT,5,T"),
        ]
        .concat();
        let later = [
            rmc("000000"),
            rmc("000001"),
            rmc("000002"),
            "$GPGGA,".to_owned(),
        ]
        .concat();
        for text in [text, later] {
            receiver.take(text.as_bytes(), |told, now_s| {
                taken.push((matches!(told, Told::Fix(fix) if fix.is_gga), now_s));
            });
        }
        let day = 86_400.0;
        let expected = [
            (true, Some(day - 1.0)),
            (false, Some(day - 1.0)),
            (false, Some(day + 1.0)),
            (false, Some(day + 2.0)),
        ];
        assert_eq!(taken, expected);
        let counters = receiver.counters();
        assert_eq!(
            (counters.fixes, counters.headings, counters.refused),
            (6, 1, 1)
        );
        assert!(counters.first_fault.as_ref().unwrap().contains("cut"));
    }
}
