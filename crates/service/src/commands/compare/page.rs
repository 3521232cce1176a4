//! What changed, in colours: a page that turns the map and prints.

use echosplat_model::glam::{DVec3, Quat};
use echosplat_model::{Gaussian, Standing};
use echosplat_recording::ply::MapFile;
use echosplat_report::{Bearings, ChangeReport, Drawn, Numbered, Table};
use echosplat_survey::{Alignment, Became, Change, Compared, Kind};

use super::{comparison, name};
use crate::arguments::VERSION;
use crate::clock;

/// The second map laid on the first, with what is only in the first.
pub(super) fn html(
    names: &[String; 2],
    [before, after]: [&MapFile; 2],
    found: &Compared,
) -> String {
    let (gaussians, changes) = merged(before, after, found);
    let numbered = found.changes.iter().enumerate();
    let numbered: Vec<Numbered> = numbered
        .map(|(index, change)| Numbered {
            number: index + 1,
            places_m: match change.kind {
                Kind::Moved => vec![change.at_m - change.by_m, change.at_m],
                Kind::Came | Kind::Went => vec![change.at_m],
            },
        })
        .collect();
    let place = before.notes.georeference.as_ref();
    let bearings = Bearings {
        x_heading_deg: place.map(|place| place.x_heading_deg),
        name: "z, m (up)".to_owned(),
        ..Bearings::default()
    };
    let drawn = Drawn {
        origin_m: before.origin_m,
        gaussians: &gaussians,
        changes: &changes,
        track_m: &[],
        numbered: &numbered,
        bearings: &bearings,
    };
    let comparison: Vec<String> = comparison(found).collect();
    let verdict = format!("{}. {}.", in_short(&found.changes), comparison.join("; "));
    let report = ChangeReport {
        title: "What changed".to_owned(),
        about: vec![
            ("Before".to_owned(), names[0].clone()),
            ("After".to_owned(), names[1].clone()),
            ("Made".to_owned(), clock::iso_utc(clock::now())),
            ("Made by".to_owned(), format!("EchoSplat {VERSION}")),
        ],
        verdict,
        table: table(&found.changes),
    };
    report.to_html(&drawn)
}

/// How many things came, went and moved; the table has them one by one.
fn in_short(changes: &[Change]) -> String {
    let told = [Kind::Came, Kind::Went, Kind::Moved].map(|kind| {
        let count = changes.iter().filter(|change| change.kind == kind).count();
        let things = if count == 1 { "thing" } else { "things" };
        (count > 0).then(|| format!("{count} {things} {}", name(kind)))
    });
    let told: Vec<String> = told.into_iter().flatten().collect();
    match told.is_empty() {
        true => "Nothing came, went or moved".to_owned(),
        false => told.join(", "),
    }
}

fn table(changes: &[Change]) -> Table {
    let three = |at: DVec3| format!("{:.2}, {:.2}, {:.2}", at.x, at.y, at.z).replace('-', "−");
    let row = |(index, change): (usize, &Change)| {
        let moved = match change.kind {
            Kind::Moved => three(change.by_m),
            Kind::Came | Kind::Went => String::new(),
        };
        let size = change.size_m;
        vec![
            (index + 1).to_string(),
            name(change.kind).to_owned(),
            three(change.at_m),
            moved,
            format!("{:.2}", change.sigma_m),
            format!("{:.1} × {:.1} × {:.1}", size.x, size.y, size.z),
            change.count.to_string(),
            format!("{:.2}", change.probability),
        ]
    };
    Table {
        title: String::new(),
        columns: [
            "",
            "what",
            "at x, y, z, m",
            "by, m",
            "± m",
            "size, m",
            "Gaussians",
            "probability",
        ]
        .map(str::to_owned)
        .into(),
        rows: changes.iter().enumerate().map(row).collect(),
        note: "Places are those of the map of before. Behind ± is one sigma.".to_owned(),
    }
}

/// All of after, and of before what is not there any more or was not looked at; each with its number in
/// [`echosplat_report::CHANGES`]. Places are relative to the origin of before.
fn merged(before: &MapFile, after: &MapFile, found: &Compared) -> (Vec<Gaussian>, Vec<u8>) {
    let laid = after.gaussians.iter().map(|gaussian| {
        let at_m = found
            .alignment
            .place(after.origin_m + gaussian.mean_m.as_dvec3());
        Gaussian {
            mean_m: (at_m - before.origin_m).as_vec3(),
            rotation: turn(&found.alignment) * gaussian.rotation,
            ..*gaussian
        }
    });
    let mut gaussians: Vec<Gaussian> = laid.collect();
    let mut changes: Vec<u8> = found.second.iter().map(|became| number(*became)).collect();
    for (gaussian, became) in before.gaussians.iter().zip(&found.first) {
        if *became != Became::Same && gaussian.standing == Standing::Confident {
            gaussians.push(*gaussian);
            changes.push(number(*became));
        }
    }
    (gaussians, changes)
}

fn turn(alignment: &Alignment) -> Quat {
    Quat::from_rotation_z(alignment.turn_deg.to_radians() as f32)
}

fn number(became: Became) -> u8 {
    match became {
        Became::Same => 0,
        Became::Came => 1,
        Became::Went => 2,
        Became::MovedFrom => 3,
        Became::MovedTo => 4,
        Became::NotLookedAt => 5,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_has_the_name_of_what_became() {
        let named = |became| echosplat_report::CHANGES[usize::from(number(became))].name;
        assert_eq!(named(Became::Same), "as before");
        assert_eq!(named(Became::Came), "came");
        assert_eq!(named(Became::Went), "went");
        assert!(
            named(Became::MovedFrom).contains("from") && named(Became::MovedTo).contains("to here")
        );
        assert!(named(Became::NotLookedAt).contains("not heard again"));
    }

    #[test]
    fn what_changed_is_counted_in_one_sentence() {
        let change = |kind| Change {
            kind,
            at_m: DVec3::ZERO,
            by_m: DVec3::ZERO,
            size_m: DVec3::ONE,
            sigma_m: 0.1,
            count: 20,
            probability: 0.9,
        };
        assert_eq!(in_short(&[]), "Nothing came, went or moved");
        let some = [Kind::Went, Kind::Came, Kind::Went].map(change);
        assert_eq!(in_short(&some), "1 thing came, 2 things went");
    }
}
