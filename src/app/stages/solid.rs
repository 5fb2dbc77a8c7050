//! Contours to the solid: `solid.bin`; which contour continues which: `topology.json`; how thick the wall is: `wall.json`.

use super::segment::SECTIONS_FILE;
use super::{read_json, to_json};
use crate::app::case::{CaseError, MadeFrom};
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::{Made, Session, hash_of};
use crate::app::settings::Body;
use crate::app::{atomic, packed};
use crate::brep::{self, Brep, Fault};
use crate::ct::Warning;
use crate::progress::Task;
use crate::solid::{self, Sectioned, SkinChoice, Solid};
use crate::topology::{Matching, drawing};
use crate::units::counted;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Which contour continues which, and why.
pub(crate) const TOPOLOGY_FILE: &str = "topology.json";
/// How thick the wall is, as built; `null` for a cast.
pub(crate) const WALL_FILE: &str = "wall.json";
/// The solid.
pub(crate) const SOLID_FILE: &str = "solid.bin";
/// Its first line; the number changes with what the surfaces are made of.
const DOCUMENT: &str = "solid 1";

/// The surfaces and what was odd about the contours.
#[derive(Deserialize)]
struct Document {
    warnings: Vec<Warning>,
    solid: Solid,
}

/// The same, borrowed for writing.
#[derive(Serialize)]
struct DocumentRef<'a> {
    warnings: &'a [Warning],
    solid: &'a Solid,
}

/// Tells of surfaces that are not proved to keep clear of each other at every height.
fn unproved(places: &[Fault]) -> Option<Warning> {
    let text = format!(
        "{} where surfaces lie too close to be proved apart at every height, the first at {}: they may meet there by less \
         than a micrometre; look at the contours near that height",
        counted(places.len(), "place"),
        places.first()?
    );
    Some(Warning::new("solid.unproved", text))
}

impl Session<'_> {
    /// Builds the solid from the contours.
    ///
    /// # Errors
    /// [`Error`] where there are no contours, where they make no solid or none that is valid, or where the case cannot be written.
    pub fn solid(&mut self) -> Result<(), Error> {
        self.spare_the_print(Stage::Solid)?;
        self.require(Stage::Segment)?;
        if let Err(refused) = self.stage(Stage::Solid, Self::build_solid) {
            if !refused.is_interruption() {
                self.show_contours();
            }
            return Err(refused);
        }
        self.hide_contours()?;
        self.topology = Some(self.matching()?.summary);
        Ok(())
    }

    /// Draws which contour continues which, and why, as SVG.
    ///
    /// # Errors
    /// [`Error`] where there is no solid, or where the file cannot be written.
    pub fn draw_matching(&mut self, path: &Path) -> Result<(), Error> {
        self.require(Stage::Solid)?;
        Ok(atomic::write_export(path, drawing::svg(&self.matching()?).as_bytes())?)
    }

    fn matching(&self) -> Result<Matching, Error> {
        Ok(read_json(&self.case.output(Stage::Solid, TOPOLOGY_FILE)?)?)
    }

    pub(crate) fn solid_made_from(&self) -> Result<MadeFrom, Error> {
        Ok(MadeFrom::from([
            ("sections", self.case.output_hash(Stage::Segment, SECTIONS_FILE)?),
            ("parameters", hash_of(&self.solid_params())),
        ]))
    }

    fn solid_params(&self) -> solid::Params {
        let settings = self.settings();
        let body = match settings.body {
            Body::WallMm(wall_mm) => solid::Body::Wall { wall_mm },
            Body::Cast => solid::Body::Cast,
        };
        let (correspondence, decisions) = (settings.correspondence, settings.decisions.clone());
        solid::Params { body, correspondence, decisions }
    }

    fn build_solid(&mut self, task: &Task<'_>) -> Result<Made, Error> {
        let params = self.solid_params();
        let mut built = solid::build(self.sections()?, &params, task)?;
        let brep = Brep::of(&built.solid, SkinChoice::All);
        built.warnings.extend(unproved(&brep::examined(&brep)?));
        let staging = self.case.staging()?;
        let document = DocumentRef { warnings: &built.warnings, solid: &built.solid };
        let bytes = packed::to_bytes(DOCUMENT, &document).expect("every list of a solid knows its length");
        staging.write(SOLID_FILE, &bytes)?;
        staging.write(TOPOLOGY_FILE, &to_json(&built.matching))?;
        let [bottom, top] = built.solid.z_range_mm();
        let what = if matches!(params.body, solid::Body::Cast) { "cast" } else { "hollow wall" };
        let mut summary = format!("{what}, z {bottom:.2} to {top:.2} mm");
        staging.write(WALL_FILE, &to_json(&built.thickness))?;
        if let Some(thickness) = &built.thickness {
            summary += &format!(", {:.3} to {:.3} mm thick", thickness.least_mm, thickness.most_mm);
        }
        self.held.solid = Some(built.solid);
        self.held.sliced = None;
        Ok(Made { staging, summary, warnings: built.warnings })
    }

    /// The solid, read unless this process has just made it.
    pub(crate) fn built(&mut self) -> Result<&Solid, Error> {
        if self.held.solid.is_none() {
            self.held.solid = Some(self.solid_document()?.solid);
        }
        Ok(self.held.solid.as_ref().expect("read just now"))
    }

    /// What was odd about the contours.
    pub(crate) fn solid_warnings(&self) -> Result<Vec<Warning>, Error> {
        Ok(self.solid_document()?.warnings)
    }

    fn solid_document(&self) -> Result<Document, Error> {
        let path = self.case.output(Stage::Solid, SOLID_FILE)?;
        let bytes = std::fs::read(&path).map_err(atomic::failed("read", &path))?;
        let problem =
            |e: packed::PackedError| format!("{e}: delete it and run `lumenfab solid` on the case again");
        Ok(packed::from_bytes(DOCUMENT, &bytes)
            .map_err(|e| CaseError::Corrupt { path, problem: problem(e) })?)
    }
}
