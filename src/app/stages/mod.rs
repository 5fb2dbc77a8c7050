//! The stages, each from files of the case to files of the case.

pub mod ask;
pub mod export;
pub mod layer_pictures;
pub mod model;
mod preview;
pub mod print;
mod ready;
pub mod report;
pub mod segment;
pub mod slice;
pub mod solid;
pub mod view;

use super::atomic;
use super::case::{CaseError, MadeFrom};
use super::error::Error;
use super::event::Stage;
use super::session::Session;
use crate::printer::paper;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

impl Session<'_> {
    /// Whether the last print of the job, should it have broken off, is given up and the bed is free: the job may be replaced then.
    pub const fn give_up_broken_off_print(&mut self, gives_up: bool) {
        self.gives_up_print = gives_up;
    }

    /// Refuses to make anew, up to `last`, what a job came from that is being printed, or whose print may be gone on with: before
    /// anything is changed.
    pub(crate) fn spare_the_print(&self, last: Stage) -> Result<(), Error> {
        let job = self.case.path(slice::JOB_FILE);
        let Err(refusal) = paper::refuse_replacing(&job, self.gives_up_print) else { return Ok(()) };
        for stage in Stage::ALL.into_iter().filter(|s| *s <= last.min(Stage::Slice)) {
            let brought = stage == Stage::Segment && self.brings_contours();
            if !brought && self.case.outdated(stage, &self.made_from(stage)?)?.is_some() {
                return Err(refusal.into());
            }
        }
        Ok(())
    }

    /// What a stage is made from, as it is now.
    pub(crate) fn made_from(&self, stage: Stage) -> Result<MadeFrom, Error> {
        let mut made_from = match stage {
            // Contours that were brought along are what they are, whatever version took them in.
            Stage::Segment if self.brings_contours() => return Ok(MadeFrom::new()),
            Stage::Segment => self.segment_made_from()?,
            Stage::Solid => self.solid_made_from()?,
            Stage::Slice => self.slice_made_from()?,
            Stage::Print => self.print_made_from()?,
            Stage::Report => self.report_made_from()?,
        };
        // Results of another version are made again.
        made_from.insert("program", env!("CARGO_PKG_VERSION").to_owned());
        Ok(made_from)
    }

    /// Refuses to go on from results that are not there or not made from what is there now: a job of yesterday's contours
    /// must not be printed as today's.
    pub(crate) fn require(&mut self, last: Stage) -> Result<(), Error> {
        for stage in Stage::ALL.into_iter().filter(|s| *s <= last) {
            if self.is_fresh(stage) {
                continue;
            }
            if stage == Stage::Segment && self.brings_contours() {
                self.require_contours()?;
            } else if let Some(changed) = self.case.outdated(stage, &self.made_from(stage)?)? {
                let dir = self.case.dir().to_owned();
                return Err(CaseError::Stale { dir, stage, changed }.into());
            }
            self.set_fresh(stage);
        }
        Ok(())
    }
}

/// A document of the case, as it is written.
pub(crate) fn to_json(value: &impl Serialize) -> Vec<u8> {
    let mut bytes =
        serde_json::to_vec(value).expect("documents of a case hold numbers, names and lists of them");
    bytes.push(b'\n');
    bytes
}

/// Reads a document of the case.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, CaseError> {
    let text = atomic::read_text(path)?;
    let problem = |e: serde_json::Error| CaseError::Corrupt { path: path.to_owned(), problem: e.to_string() };
    serde_json::from_str(&text).map_err(problem)
}
