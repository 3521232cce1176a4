//! Maps in coordinates of the Earth: LAS and LAZ, `GeoTIFF`, `GeoJSON`, KML, and tracks with latitude.

mod geotiff;
mod las;
mod raster;
mod shapes;
mod track;

use echosplat_georeference::{Crs, CrsError, Datum, Georeference, LengthUnit};
use echosplat_model::Gaussian;
use echosplat_model::glam::DVec3;

use super::{sound, world_m};
use crate::ply::MapFile;
pub use geotiff::write_geotiff;
pub use las::{Compression, write_las};
pub use raster::{Raster, RasterError};
pub use shapes::{Feature, Shape, features_of, write_geojson, write_kml};
pub use track::{write_track_csv, write_track_tum};

/// A world on the Earth, and the coordinates that it is told in.
#[derive(Debug)]
pub struct Placed {
    /// Where the world lies.
    pub georeference: Georeference,
    /// What places are told in.
    pub crs: Crs,
}

impl Placed {
    /// East and north in the unit of the coordinates, and height over the georeference's datum in metres.
    ///
    /// # Errors
    /// If the projection does not show it.
    pub fn at(&self, world_m: DVec3) -> Result<DVec3, CrsError> {
        let place = self.georeference.place_of(world_m);
        let mut at = self.crs.project(&place)?;
        if self.crs.unit() == LengthUnit::Degrees {
            // One piece across the antimeridian: beyond 180 there, not at the other end of the map.
            let middle_deg = self.georeference.place.longitude_deg;
            at.x += 360.0 * ((middle_deg - at.x) / 360.0).round();
        }
        Ok(at.extend(place.height_m))
    }

    /// Each Gaussian that is sound, with its coordinates as [`Placed::at`] has them.
    ///
    /// # Errors
    /// If the projection does not show one of them.
    pub fn gaussians<'m>(&self, map: &'m MapFile) -> Result<Vec<(DVec3, &'m Gaussian)>, CrsError> {
        let placed = |gaussian| Ok((self.at(world_m(map.origin_m, gaussian))?, gaussian));
        sound(map).map(placed).collect()
    }

    /// Well-known text; with heights over mean sea level it says so. Other datums have no code to be named by.
    #[must_use]
    pub fn wkt(&self) -> String {
        let horizontal = self.crs.wkt();
        match self.georeference.datum {
            Datum::MeanSea => format!(
                r#"COMPD_CS["{} + MSL height",{horizontal},VERT_CS["MSL height",VERT_DATUM["Mean Sea Level",2005,AUTHORITY["EPSG","5100"]],UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Gravity-related height",UP],AUTHORITY["EPSG","5714"]]]"#,
                self.crs.name()
            ),
            Datum::Surface | Datum::Ellipsoid => horizontal.to_owned(),
        }
    }

    /// What heights in a file mean, in a sentence.
    #[must_use]
    pub fn heights_in_words(&self) -> String {
        format!(
            "Heights are metres above {}.",
            self.georeference.datum.in_words()
        )
    }
}

#[cfg(test)]
mod tests;
