//! What is to be measured, as the command line, a file of measures and the page say it.

use echosplat_model::glam::DVec3;

/// Metres; pieces of a profile unless asked otherwise.
pub(crate) const STEP_M: f64 = 0.1;
/// Metres; farthest that the page may have looked around.
const MOST_WITHIN_M: f64 = 5.0;
/// Metres; longest line that the page may have cut along.
const MOST_LINE_M: f64 = 200.0;

/// A size; places are the world's, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum What {
    Distance([DVec3; 2]),
    Pile(DVec3),
    Plane(DVec3),
    Profile([DVec3; 2]),
    Section([DVec3; 2]),
}

/// A size, and how far around is looked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Asked {
    pub(crate) what: What,
    /// Metres; what is usual of its kind if `None`.
    pub(crate) within_m: Option<f64>,
    /// Of the pieces of a profile, metres.
    pub(crate) step_m: f64,
}

impl Asked {
    /// As it is usual.
    pub(crate) fn usual(what: What) -> Self {
        Self {
            what,
            within_m: None,
            step_m: STEP_M,
        }
    }

    /// As the page asks: `pile=1.5,-2,-3&within=0.8`, of a line both ends one after the other.
    ///
    /// # Errors
    /// Says what is wrong, and what would be right. What would take long is refused: it belongs to `echosplat measure`.
    pub(crate) fn of_query(query: &str) -> Result<Self, String> {
        let mut what = None;
        let mut within_m = None;
        for pair in query.split('&') {
            let (name, text) = pair.split_once('=').unwrap_or((pair, ""));
            if name == "within" {
                let found: f64 = text.parse().unwrap_or(f64::NAN);
                if !(found > 0.0 && found <= MOST_WITHIN_M) {
                    return Err(format!(
                        "within={text}: it must be more than 0 and at most {MOST_WITHIN_M} m"
                    ));
                }
                within_m = Some(found);
            } else if what.replace(what_of(name, text)?).is_some() {
                return Err(format!(
                    "{name}={text}: only one size is measured at a time"
                ));
            }
        }
        let what = what.ok_or_else(|| wanted("nothing"))?;
        Ok(Self {
            within_m,
            ..Self::usual(what)
        })
    }
}

fn wanted(found: &str) -> String {
    format!(
        "{found}: ask for distance, profile or section, of two places as X,Y,Z,X,Y,Z, or for pile or plane, of one as \
         X,Y,Z, in metres of the world"
    )
}

fn what_of(name: &str, text: &str) -> Result<What, String> {
    let wrong = || wanted(&format!("{name}={text}"));
    let numbers: Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
    let numbers: Vec<f64> = numbers.map_err(|_| wrong())?;
    if numbers.iter().any(|number| !number.is_finite()) {
        return Err(wrong());
    }
    match (name, &numbers[..]) {
        ("pile", &[x, y, z]) => Ok(What::Pile(DVec3::new(x, y, z))),
        ("plane", &[x, y, z]) => Ok(What::Plane(DVec3::new(x, y, z))),
        ("distance" | "profile" | "section", &[x, y, z, to_x, to_y, to_z]) => {
            let ends_m = [DVec3::new(x, y, z), DVec3::new(to_x, to_y, to_z)];
            let length_m = ends_m[0].distance(ends_m[1]);
            match name {
                "distance" => Ok(What::Distance(ends_m)),
                _ if length_m > MOST_LINE_M => Err(format!(
                    "{name}: the line is {length_m:.0} m long; the page cuts along {MOST_LINE_M} m at most, `echosplat \
                     measure` along any"
                )),
                "profile" => Ok(What::Profile(ends_m)),
                _ => Ok(What::Section(ends_m)),
            }
        }
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_page_asks_is_read() {
        let asked = Asked::of_query("pile=1.5,-2,-3&within=0.8").unwrap();
        assert_eq!(asked.what, What::Pile(DVec3::new(1.5, -2.0, -3.0)));
        assert_eq!(asked.within_m, Some(0.8));
        let asked = Asked::of_query("profile=0,0,0,1,2,3").unwrap();
        assert_eq!(
            asked,
            Asked::usual(What::Profile([DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0)]))
        );
    }

    #[test]
    fn what_is_wrong_or_takes_long_is_refused_with_what_would_be_right() {
        for (query, says) in [
            ("", "X,Y,Z"),
            ("pile=1,2", "pile=1,2: ask for"),
            ("pile=1,2,nan", "X,Y,Z"),
            ("pile=1,2,3&plane=1,2,3", "only one"),
            ("pile=1,2,3&within=50", "at most 5 m"),
            ("pile=1,2,3&within=", "within="),
            ("width=1,2,3", "width=1,2,3"),
            ("profile=0,0,0,300,0,0", "200 m at most"),
        ] {
            let refused = Asked::of_query(query).unwrap_err();
            assert!(refused.contains(says), "{query}: {refused}");
        }
    }
}
