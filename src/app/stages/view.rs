//! The solid as a shaded picture, to be looked at before anything is exported or printed.

use super::export::check_target;
use crate::app::atomic;
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::Session;
use crate::geom::Point2;
use crate::mesh::colour::{ColourScale, mean_curvature};
use crate::mesh::{self, Part, Parted, Tessellation};
use crate::progress::Task;
use crate::solid::{Skin, SkinChoice};
use crate::view::{self, Direction, Middle, Paint, Scene};
use rayon::prelude::*;
use std::path::PathBuf;

/// What surfaces are coloured by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Colouring {
    /// Material: wall and lumen.
    #[default]
    None,
    /// Mean curvature.
    Curvature,
}

impl Colouring {
    /// What the scale of colours is headed with.
    const CURVATURE_TITLE: &str = "mean curvature, 1/mm";
}

/// The picture that is wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// PNG to write.
    pub file: PathBuf,
    /// Directions, side by side; from the front, the left and obliquely where none is given.
    pub from: Vec<Direction>,
    /// Height of the picture.
    pub size_px: u32,
    /// Colours.
    pub colouring: Colouring,
    /// Whether the body is cut open, so that its lumen is seen.
    pub is_cut: bool,
}

/// Where nothing is said.
const DEFAULT_FROM: [Direction; 3] = [Direction::Front, Direction::Left, Direction::Oblique];
/// Heights at which the middle of the lumen is taken, along the whole body.
const MIDDLE_ROWS: u32 = 400;

impl Session<'_> {
    /// Draws the solid.
    ///
    /// # Errors
    /// [`Error`] where there is no solid, where it cannot be meshed, or where the picture cannot be written.
    pub fn view(&mut self, wanted: &View) -> Result<(), Error> {
        check_target("view", &wanted.file, self.case.dir())?;
        self.require(Stage::Solid)?;
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let patient_from_stack = self.sections()?.patient_from_stack;
        let solid = self.built()?;
        // Chords shorter than a pixel sees: half a pixel at the scale of the whole body.
        let [low, high] = crate::solid::Sectioned::z_range_mm(solid);
        let deflection_mm = (0.5 * (high - low) / f64::from(wanted.size_px)).clamp(0.005, 0.5);
        let made = mesh::parted(solid, &Tessellation::within(deflection_mm, SkinChoice::All), &task)?;
        let paint = match wanted.colouring {
            // A cast is the lumen.
            Colouring::None if solid.outer.is_none() => {
                Paint::Skins { is_lumen: vec![true; made.parts.len()] }
            }
            Colouring::None => Paint::Skins { is_lumen: is_lumen(&made).collect() },
            Colouring::Curvature => {
                let values = curvature(&made);
                let scale = ColourScale::over(&values);
                Paint::Values { values, scale, title: Colouring::CURVATURE_TITLE }
            }
        };
        let cut = wanted.is_cut.then(|| middle_of(&solid.lumen));
        let scene = Scene { mesh: &made.mesh, paint, patient_from_stack, cut };
        let from = if wanted.from.is_empty() { &DEFAULT_FROM[..] } else { &wanted.from };
        let png = view::render(&scene, from, wanted.size_px, &task)?;
        atomic::write_export(&wanted.file, &png)?;
        self.view = Some(wanted.file.clone());
        Ok(())
    }
}

/// Which triangles bound the lumen.
fn is_lumen(made: &Parted) -> impl Iterator<Item = bool> {
    made.parts.iter().map(|part| *part == Part::Lumen)
}

/// Mean curvature of the vessel at a mesh's vertices, 1/mm: both skins of a wall as seen from outside the vessel, a tube of
/// radius r having 1 / 2r on either.
pub(super) fn curvature(made: &Parted) -> Vec<f64> {
    let mut values = mean_curvature(&made.mesh);
    if made.parts.contains(&Part::Outer) {
        let mut is_inner = vec![false; values.len()];
        let of_lumen = made.mesh.triangles.iter().zip(is_lumen(made)).filter(|(_, is)| *is);
        of_lumen.flat_map(|(t, _)| t).for_each(|&v| is_inner[v as usize] = true);
        // Seen from the material, the lumen is hollow.
        values.iter_mut().zip(is_inner).filter(|(_, inner)| *inner).for_each(|(v, _)| *v = -*v);
    }
    values
}

/// The middle of the lumen along its height.
fn middle_of(lumen: &Skin) -> Middle {
    let [low, high] = lumen.z_range_mm();
    let row = |i: u32| {
        let z = low + (high - low) * f64::from(i) / f64::from(MIDDLE_ROWS);
        let middles: Vec<Point2> =
            lumen.section(z, 0.02).iter().map(crate::geom::Contour::centroid).collect();
        (z, middles)
    };
    let rows: Vec<(f64, Vec<Point2>)> = (0..=MIDDLE_ROWS).into_par_iter().map(row).collect();
    Middle { rows: rows.into_iter().filter(|r| !r.1.is_empty()).collect() }
}
