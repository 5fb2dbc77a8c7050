//! Pictures of the contours over the CT, for the operator whose contours make no solid: `planes/plane-000.png`, ...

use crate::app::atomic;
use crate::app::error::Error;
use crate::app::event::{Event, Stage};
use crate::app::session::Session;
use crate::ct::Warning;
use crate::progress::Task;
use crate::report::preview;
use std::path::PathBuf;

/// Where they are, in the case.
const PLANES_DIR: &str = "planes";

impl Session<'_> {
    /// Draws every plane and says where. The refusal of the solid is what counts: that a picture could not be written is told
    /// beside it, no more.
    pub(super) fn show_contours(&mut self) {
        let (code, text) = match self.draw_contours() {
            Ok(dir) => {
                ("solid.pictures", format!("each plane's contours over the CT are in {}", dir.display()))
            }
            Err(e) => (
                "solid.no_pictures",
                format!("the contours could not be drawn: {}", e.text_without_sources()),
            ),
        };
        (self.context.events)(Event::Warned { stage: Stage::Solid, warning: Warning::new(code, text) });
    }

    /// Removes what an earlier refusal has left.
    pub(super) fn hide_contours(&self) -> Result<(), Error> {
        let dir = self.case.path(PLANES_DIR);
        if dir.exists() { Ok(atomic::remove(&dir)?) } else { Ok(()) }
    }

    fn draw_contours(&mut self) -> Result<PathBuf, Error> {
        self.volume()?;
        self.sections()?;
        let sections = self.held.sections.as_ref().expect("read just now");
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let pictures = preview::of_contours(sections, self.held.volume.as_ref(), &task)?;
        self.hide_contours()?;
        let dir = self.case.path(PLANES_DIR);
        std::fs::create_dir_all(&dir).map_err(atomic::failed("create", &dir))?;
        for picture in &pictures {
            atomic::write(&dir.join(picture.file_name()), &picture.png)?;
        }
        Ok(dir)
    }
}
