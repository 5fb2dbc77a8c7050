//! The solid as files for other programs.

use crate::app::atomic;
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::Session;
use crate::mesh::{self, Deflection, SkinChoice, Tessellation};
use crate::progress::Task;
use serde::Serialize;
use std::path::{Path, PathBuf};

pub use crate::mesh::SkinChoice as Skin;

/// A mesh that was written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Exported {
    /// The file.
    pub stl: PathBuf,
    /// Triangles in it.
    pub n_triangles: usize,
    /// What it encloses, mm³.
    pub volume_mm3: f64,
    /// The deflection that was asked for, mm.
    pub deflection_mm: f64,
}

impl std::fmt::Display for Exported {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { stl, n_triangles, volume_mm3, deflection_mm } = self;
        let stl = stl.display();
        write!(f, "{stl}: {n_triangles} triangles, {volume_mm3:.1} mm3, deflection {deflection_mm} mm")
    }
}

impl Session<'_> {
    /// Writes the solid, or its lumen alone, as binary STL.
    ///
    /// # Errors
    /// [`Error`] where there is no solid, where its mesh is not closed, or where the file cannot be written.
    pub fn export_stl(
        &mut self,
        path: &Path,
        skin: SkinChoice,
        deflection_mm: f64,
    ) -> Result<Exported, Error> {
        self.require(Stage::Solid)?;
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let mesh = mesh::tessellate(
            self.built()?,
            &Tessellation { deflection: Deflection::Absolute { mm: deflection_mm }, skin },
            &task,
        )?;
        task.check()?;
        mesh::stl::write(path, &mesh).map_err(atomic::failed("write", path))?;
        Ok(Exported {
            stl: path.to_owned(),
            n_triangles: mesh.triangles.len(),
            volume_mm3: mesh.volume_mm3(),
            deflection_mm,
        })
    }
}
