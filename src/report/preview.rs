//! Contours over the image, plane by plane, before there is a solid: what an operator looks at when none can be made.
//!
//! The pictures are those of the report without what a solid, its layers and its beads would add: same frame, same scale
//! for all planes, the boundary dashed in green.

use super::picture::{Scene, Window, frame_of, paint};
use super::{Error, Picture};
use crate::ct::Volume;
use crate::geom::{Contour, Region};
use crate::progress::Task;
use crate::sections::SectionStack;
use crate::solid::CrossSection;
use rayon::prelude::*;

/// A contour's plane is the image's where their heights differ by less, mm.
const SAME_HEIGHT_MM: f64 = 1e-3;

/// A picture of every plane of the contours; without an image they stand on a plain ground.
///
/// # Errors
/// [`Error::Picture`] where one cannot be drawn, [`Error::Cancelled`].
pub fn of_contours(
    sections: &SectionStack,
    image: Option<&Volume>,
    task: &Task<'_>,
) -> Result<Vec<Picture>, Error> {
    let none = CrossSection { outer: Region::default(), lumen: Region::default() };
    let all = sections.planes.iter().flat_map(|p| &p.contours);
    let frame = frame_of(all.filter_map(Contour::bounds));
    let window = Window::of_levels(None, None, image);
    let plane_of = |z_mm: f64| {
        let same = |z: &f64| (z - z_mm).abs() < SAME_HEIGHT_MM;
        image.and_then(|volume| Some((volume, volume.plane_z_mm.iter().position(same)?)))
    };
    let picture = |(plane, own): (usize, &crate::sections::PlaneSections)| {
        task.check()?;
        paint(&Scene {
            plane,
            z_mm: own.z_mm,
            frame,
            image: plane_of(own.z_mm),
            window,
            patient_from_stack: sections.patient_from_stack,
            recorded: None,
            centre_lines: Vec::new(),
            solid: &none,
            contours: &own.contours,
            reference: None,
            deposited: None,
            scanned: None,
        })
    };
    sections.planes.par_iter().enumerate().map(picture).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ct::Voxels;
    use crate::geom::{Point2, RigidTransform};
    use crate::sections::PlaneSections;

    #[test]
    fn every_plane_has_a_picture_of_one_size_with_and_without_an_image() {
        let plane = |k: u8| PlaneSections {
            z_mm: 3.0 * f64::from(k),
            contours: vec![Contour::circle(Point2::new(8.0, 7.0), 2.0 + f64::from(k), 64)],
        };
        let sections = SectionStack {
            planes: (0..3).map(plane).collect(),
            patient_from_stack: RigidTransform::identity(),
        };
        let volume = Volume {
            dims: [32, 28, 3],
            hu: Voxels::new(&[[0.0; 13].as_slice(), &[300.0; 19]].concat().repeat(28 * 3), 32 * 28),
            origin_xy_mm: [0.0; 2],
            pixel_spacing_xy_mm: [0.5; 2],
            plane_z_mm: vec![0.0, 3.0, 6.0],
            slab_thickness_mm: 2.0,
            patient_from_stack: RigidTransform::identity(),
        };
        let plain = of_contours(&sections, None, &Task::quiet()).unwrap();
        let over = of_contours(&sections, Some(&volume), &Task::quiet()).unwrap();
        assert_eq!(plain.len(), 3);
        for (a, b) in plain.iter().zip(&over) {
            assert_eq!((a.file_name(), a.size_px), (b.file_name(), plain[0].size_px));
            assert_ne!(a.png, b.png);
        }
    }
}
