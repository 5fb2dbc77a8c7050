//! The solid as files for other programs.

use super::view::{self, Colouring};
use crate::app::atomic;
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::{Session, Stopwatch, hash_of};
use crate::app::settings::{Body, Fault, SettingError};
use crate::brep::{self, Brep};
use crate::mesh::colour::ColourScale;
use crate::mesh::threemf::{Colour, Description};
use crate::mesh::{self, MeasuredMesh, Parted, Tessellation, sweep};
use crate::progress::Task;
use crate::solid::{SkinChoice, Solid};
use crate::step;
use serde::Serialize;
use std::path::{Path, PathBuf};

pub use crate::solid::SkinChoice as Skin;

/// Deflection of the mesh on which surfaces are tested that are written without one as fine, mm.
const TEST_DEFLECTION_MM: f64 = 0.05;

/// How fine an exported mesh is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Deflection {
    /// Farthest that the surface may be from its triangles, mm.
    #[serde(rename = "deflection_mm")]
    Absolute(f64),
    /// The same as a fraction of the vessel's local radius.
    #[serde(rename = "deflection_relative")]
    Relative(f64),
}

impl From<Deflection> for mesh::Deflection {
    fn from(deflection: Deflection) -> Self {
        match deflection {
            Deflection::Absolute(mm) => Self::Absolute { mm },
            Deflection::Relative(fraction) => Self::Relative { fraction },
        }
    }
}

impl Deflection {
    /// Whether a mesh that keeps it is everywhere within so much; by a fraction alone that is not known.
    fn is_within(self, most_mm: f64) -> bool {
        matches!(self, Self::Absolute(mm) if mm <= most_mm)
    }
}

impl std::fmt::Display for Deflection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Absolute(mm) => write!(f, "deflection {mm} mm"),
            Self::Relative(fraction) => write!(f, "deflection {fraction} of the local radius"),
        }
    }
}

/// The files that are wanted, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Export {
    /// Binary STL.
    pub stl: Option<PathBuf>,
    /// 3MF.
    pub three_mf: Option<PathBuf>,
    /// STEP (AP242): the exact surfaces.
    pub step: Option<PathBuf>,
    /// Table of triangles against deflection; its plot goes beside it.
    pub sweep: Option<PathBuf>,
    /// The printed body, or the lumen alone.
    pub skin: SkinChoice,
    /// How fine the mesh is.
    pub deflection: Deflection,
    /// Colours, where a format has them.
    pub colouring: Colouring,
}

/// The mesh that was written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Meshed {
    /// Triangles in it.
    pub n_triangles: usize,
    /// What it encloses, mm³.
    pub volume_mm3: f64,
    /// The deflection that was asked for.
    #[serde(flatten)]
    pub deflection: Deflection,
}

/// The exact surfaces that were written.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SteppedSolid {
    /// Faces in the file.
    pub n_faces: usize,
    /// What the surfaces enclose, exactly, mm³.
    pub brep_volume_mm3: f64,
}

/// What was written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Exported {
    /// The STL.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stl: Option<PathBuf>,
    /// The 3MF.
    #[serde(rename = "3mf", skip_serializing_if = "Option::is_none")]
    pub three_mf: Option<PathBuf>,
    /// The STEP file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<PathBuf>,
    /// The table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep: Option<PathBuf>,
    /// The table's plot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plot: Option<PathBuf>,
    /// What is in the STL and the 3MF.
    #[serde(flatten)]
    pub mesh: Option<Meshed>,
    /// What is in the STEP file.
    #[serde(flatten)]
    pub surfaces: Option<SteppedSolid>,
    /// What is in the table.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<TimedRow>,
}

/// A row of the table and how long its mesh took; times differ from run to run and stay out of the file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimedRow {
    /// The row.
    #[serde(flatten)]
    pub row: MeasuredMesh,
    /// Time for the mesh, s.
    pub elapsed_s: f64,
}

impl std::fmt::Display for Exported {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if let Some(Meshed { n_triangles, volume_mm3, deflection }) = self.mesh {
            for path in self.stl.iter().chain(&self.three_mf) {
                writeln!(
                    f,
                    "{}: {n_triangles} triangles, {volume_mm3:.1} mm3, {deflection}",
                    path.display()
                )?;
            }
        }
        if let (Some(path), Some(SteppedSolid { n_faces, brep_volume_mm3 })) = (&self.step, self.surfaces) {
            writeln!(f, "{}: {n_faces} faces, {brep_volume_mm3:.1} mm3", path.display())?;
        }
        for TimedRow { row, elapsed_s } in &self.rows {
            writeln!(f, "{row}, {elapsed_s:.3} s")?;
        }
        for path in self.sweep.iter().chain(&self.plot) {
            writeln!(f, "{}", path.display())?;
        }
        Ok(())
    }
}

impl Export {
    fn paths(&self) -> impl Iterator<Item = (&'static str, PathBuf)> {
        let plot = self.sweep.as_deref().map(plot_beside);
        let named = [
            ("stl", &self.stl),
            ("3mf", &self.three_mf),
            ("step", &self.step),
            ("sweep", &self.sweep),
            ("sweep", &plot),
        ];
        let paths: Vec<_> =
            named.into_iter().filter_map(|(name, path)| Some((name, path.clone()?))).collect();
        paths.into_iter()
    }

    /// Refuses files that cannot be written, that would replace each other or something that no export made, before any
    /// work is done.
    fn check(&self, case: &Path) -> Result<(), Error> {
        let mut seen: Vec<(&str, PathBuf)> = Vec::new();
        for (name, path) in self.paths() {
            if let Some((other, _)) = seen.iter().find(|(_, p)| *p == path) {
                let (found, expected) =
                    (path.display().to_string(), format!("another file than for --{other}"));
                return Err(SettingError { name: name.into(), fault: Fault { found, expected } }.into());
            }
            check_target(name, &path, case)?;
            seen.push((name, path));
        }
        Ok(())
    }
}

/// Endings of the files that an option writes.
fn endings(name: &str) -> &'static [&'static str] {
    match name {
        "stl" => &["stl"],
        "3mf" => &["3mf"],
        "step" => &["step", "stp"],
        "sweep" => &["csv", "svg"],
        "out" => &["gcode", "gco", "g"],
        _ => &["png"],
    }
}

/// Refuses a file that cannot be written, and one that would replace what is not an earlier export: whatever is there
/// already under another ending (a picture of the series, contours, a job), and anything a case keeps in its folders.
pub(super) fn check_target(name: &'static str, path: &Path, case: &Path) -> Result<(), Error> {
    let refused = |expected: String| {
        let fault = Fault { found: path.display().to_string(), expected };
        Err(SettingError { name: name.into(), fault }.into())
    };
    let endings = endings(name);
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let is_own = ending.is_some_and(|e| endings.contains(&e.as_str()));
    if path.is_file() && !is_own {
        return refused(format!("a new file, or one that ends in .{} to replace", endings.join(" or .")));
    }
    if !path.is_dir() && is_kept_by_case(path, case) {
        return refused("a file outside the folders in which the case keeps its results".into());
    }
    Ok(atomic::check_export(path)?)
}

/// Whether a path lies in a folder inside the case.
fn is_kept_by_case(path: &Path, case: &Path) -> bool {
    let found = (atomic::parent(path).canonicalize(), case.canonicalize());
    matches!(found, (Ok(folder), Ok(case)) if folder != case && folder.starts_with(&case))
}

/// The plot's place: that of the table, as a picture.
fn plot_beside(table: &Path) -> PathBuf {
    table.with_extension("svg")
}

impl Session<'_> {
    /// Writes the solid, or its lumen alone, as the files that are asked for: all of them or none.
    ///
    /// # Errors
    /// [`Error`] where there is no solid, where its surfaces are not valid, where its mesh is not closed, meets itself or does
    /// not keep the deflection, or where a file cannot be written.
    pub fn export(&mut self, wanted: &Export) -> Result<Exported, Error> {
        wanted.check(self.case.dir())?;
        self.require(Stage::Solid)?;
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let about = self.description(wanted)?;
        let solid = self.built()?;
        let mut files: Vec<(&Path, Vec<u8>)> = Vec::new();
        let is_meshed = wanted.stl.is_some() || wanted.three_mf.is_some();
        let made = is_meshed.then(|| kept_mesh_of(solid, wanted, &task)).transpose()?;
        if let Some(made) = &made {
            files.extend(mesh_files(made, wanted, about)?);
        }
        let mut surfaces = None;
        if let Some(path) = &wanted.step {
            let brep = Brep::of(solid, wanted.skin);
            brep::check(&brep)?;
            let is_tested = made.is_some() && wanted.deflection.is_within(TEST_DEFLECTION_MM);
            if !is_tested {
                // What happens between the sections that the check looks at, triangles show.
                mesh_of(solid, wanted.skin, Deflection::Absolute(TEST_DEFLECTION_MM), &task)?;
            }
            files.push((path, step::to_step(&brep).into_bytes()));
            surfaces = Some(SteppedSolid { n_faces: brep.faces.len(), brep_volume_mm3: brep.volume_mm3() });
        }
        let plot = wanted.sweep.as_deref().map(plot_beside);
        let mut rows = Vec::new();
        if let (Some(table), Some(plot)) = (&wanted.sweep, &plot) {
            rows = swept(solid, wanted.skin, &task)?;
            let plain: Vec<MeasuredMesh> = rows.iter().map(|r| r.row).collect();
            files.push((table, sweep::csv(&plain).into_bytes()));
            files.push((plot, sweep::svg(&plain).into_bytes()));
        }
        task.check()?;
        let files: Vec<(&Path, &[u8])> = files.iter().map(|(path, bytes)| (*path, &bytes[..])).collect();
        atomic::write_exports(&files)?;
        let Export { stl, three_mf, step, sweep, .. } = wanted.clone();
        let mesh = made.as_ref().map(|made| Meshed::of(made, wanted.deflection));
        Ok(Exported { stl, three_mf, step, sweep, plot, mesh, surfaces, rows })
    }

    /// What a 3MF says about itself.
    fn description(&self, wanted: &Export) -> Result<Description, Error> {
        let body = match (wanted.skin, &self.settings().body) {
            (SkinChoice::Lumen, _) => "lumen",
            (SkinChoice::All, Body::Cast) => "cast",
            (SkinChoice::All, Body::WallMm(_)) => "wall",
        };
        let deflection = match wanted.deflection {
            Deflection::Absolute(mm) => ("DeflectionMm", mm.to_string()),
            Deflection::Relative(fraction) => ("DeflectionRelative", fraction.to_string()),
        };
        let settings = ("SettingsHash", hash_of(&self.made_from(Stage::Solid)?));
        Ok(Description { body: body.into(), facts: vec![deflection, settings] })
    }
}

/// The files of a mesh.
fn mesh_files<'w>(
    made: &Parted,
    wanted: &'w Export,
    about: Description,
) -> Result<Vec<(&'w Path, Vec<u8>)>, Error> {
    let mut files: Vec<(&Path, Vec<u8>)> = Vec::new();
    if let Some(path) = &wanted.stl {
        files.push((path, mesh::stl::to_bytes(&made.mesh)?));
    }
    if let Some(path) = &wanted.three_mf {
        let colours = colours(made, wanted.colouring);
        files.push((path, mesh::threemf::to_bytes(&made.mesh, &colours, &about)));
    }
    Ok(files)
}

impl Meshed {
    fn of(made: &Parted, deflection: Deflection) -> Self {
        Self { n_triangles: made.mesh.triangles.len(), volume_mm3: made.mesh.volume_mm3(), deflection }
    }
}

/// The mesh as it will be in a file: of 32-bit floats, closed, and meeting itself nowhere; within the deflection, or with
/// how far it is off.
fn mesh_of(
    solid: &Solid,
    skin: SkinChoice,
    deflection: Deflection,
    task: &Task<'_>,
) -> Result<Parted, Error> {
    Ok(mesh::parted(solid, &Tessellation { deflection: deflection.into(), skin }, task)?)
}

/// The mesh as it is wanted: within the deflection.
fn kept_mesh_of(solid: &Solid, wanted: &Export, task: &Task<'_>) -> Result<Parted, Error> {
    Ok(mesh_of(solid, wanted.skin, wanted.deflection, task)?.kept(wanted.deflection.into())?)
}

/// Colours of a mesh's vertices; none where none are asked for.
fn colours(made: &Parted, colouring: Colouring) -> Vec<Colour> {
    match colouring {
        Colouring::None => Vec::new(),
        Colouring::Curvature => {
            let values = view::curvature(made);
            let scale = ColourScale::over(&values);
            values.into_iter().map(|v| scale.colour(v)).collect()
        }
    }
}

/// The rows of the table.
fn swept(solid: &Solid, skin: SkinChoice, task: &Task<'_>) -> Result<Vec<TimedRow>, Error> {
    let row = |deflection_mm: f64| {
        let clock = Stopwatch::start();
        let Parted { mesh, .. } = mesh_of(solid, skin, Deflection::Absolute(deflection_mm), task)?;
        let elapsed_s = clock.elapsed_s();
        Ok(TimedRow { row: mesh::measure(solid, skin, &mesh, deflection_mm, task)?, elapsed_s })
    };
    sweep::DEFLECTIONS_MM.into_iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_tested_on_a_mesh_of_their_own_unless_the_one_written_is_as_fine() {
        let is_fine = |deflection: Deflection| deflection.is_within(TEST_DEFLECTION_MM);
        assert!(is_fine(Deflection::Absolute(0.05)) && is_fine(Deflection::Absolute(0.002)));
        assert!(!is_fine(Deflection::Absolute(5.0)) && !is_fine(Deflection::Relative(1e-4)));
    }
}
