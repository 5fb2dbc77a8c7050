//! Contours to the solid: `solid.json`.

use super::segment::SECTIONS_FILE;
use super::{read_json, to_json};
use crate::app::case::MadeFrom;
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::{Made, Session, hash_of};
use crate::app::settings::Body;
use crate::brep::{self, Brep};
use crate::ct::Warning;
use crate::mesh::SkinChoice;
use crate::progress::Task;
use crate::solid::{self, Sectioned, Solid};
use serde::{Deserialize, Serialize};

/// The solid.
pub(crate) const SOLID_FILE: &str = "solid.json";

/// `solid.json`: the surfaces and what was odd about the contours.
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

impl Session<'_> {
    /// Builds the solid from the contours.
    ///
    /// # Errors
    /// [`Error`] where there are no contours, where they make no solid or none that is valid, or where the case cannot be written.
    pub fn solid(&mut self) -> Result<(), Error> {
        self.require(Stage::Segment)?;
        self.stage(Stage::Solid, Self::build_solid)
    }

    pub(crate) fn solid_made_from(&self) -> Result<MadeFrom, Error> {
        Ok(MadeFrom::from([
            ("sections", self.case.output_hash(Stage::Segment, SECTIONS_FILE)?),
            ("parameters", hash_of(&self.settings().body)),
        ]))
    }

    fn build_solid(&mut self, task: &Task<'_>) -> Result<Made, Error> {
        let body = match self.settings().body {
            Body::WallMm(wall_mm) => solid::Body::Wall { wall_mm },
            Body::Cast => solid::Body::Cast,
        };
        let built = solid::build(self.sections()?, &solid::Params { body }, task)?;
        brep::check(&Brep::of(&built.solid, SkinChoice::All))?;
        let staging = self.case.staging()?;
        staging
            .write(SOLID_FILE, &to_json(&DocumentRef { warnings: &built.warnings, solid: &built.solid }))?;
        let [bottom, top] = built.solid.z_range_mm();
        let what = if matches!(body, solid::Body::Cast) { "cast" } else { "hollow wall" };
        let summary = format!("{what}, z {bottom:.2} to {top:.2} mm");
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
        Ok(read_json(&self.case.output(Stage::Solid, SOLID_FILE)?)?)
    }
}
