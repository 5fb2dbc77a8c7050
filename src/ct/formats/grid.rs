//! A grid of voxels in the patient to the stack's frame: which way its axes run, what is turned over.
//!
//! The third axis of the array is the slice axis: planes are stacked along it. As for DICOM series, the stack's z is the planes'
//! normal, columns x rows; where columns and rows run along the patient's left-right and front-back axes, whichever way, the stack
//! is the patient's LPS frame itself and the voxels are turned over for it. A left-handed grid, whose slice axis runs against the
//! normal, has its planes turned over: the transform stays a rotation.

use super::Fault;
use crate::ct::axes::along;
use crate::ct::{Volume, Voxels, Warning};
use crate::geom::{Point3, RigidTransform, Vector3};

/// What a grid may miss its right angles by over its whole length, in pixels: silently, and with a warning.
const SHEAR_PIXELS: [f64; 2] = [0.1, 0.5];

/// A parallelepiped of voxels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grid {
    /// Columns, rows, planes.
    pub(crate) dims: [usize; 3],
    /// Centre of the first voxel, LPS, mm.
    pub(crate) origin: Point3,
    /// From a voxel to the next column, row, plane, LPS, mm.
    pub(crate) axes_mm: [Vector3; 3],
}

/// Where a grid lies as a stack.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Placed {
    /// Columns, rows, planes.
    pub(crate) dims: [usize; 3],
    /// Whether columns, rows, planes are to be read in reverse.
    pub(crate) turned: [bool; 3],
    pub(crate) origin_xy_mm: [f64; 2],
    pub(crate) pixel_spacing_xy_mm: [f64; 2],
    pub(crate) plane_z_mm: Vec<f64>,
    pub(crate) patient_from_stack: RigidTransform,
    pub(crate) warnings: Vec<Warning>,
}

/// What is wrong with axes whose numbers do not span a volume.
pub(super) fn spans_nothing(format: &'static str, field: &'static str, expected: &'static str) -> Fault {
    Fault::Field { format, field, found: "numbers that span no volume".into(), expected }
}

impl Grid {
    /// Whether all its numbers can be worked with, and its axes are three.
    pub(crate) fn is_sound(&self) -> bool {
        let small = |v: f64| v.is_finite() && v.abs() < 1e6;
        let lengths = self.axes_mm.map(|a| a.norm());
        let volume = self.axes_mm[0].cross(&self.axes_mm[1]).dot(&self.axes_mm[2]).abs();
        self.origin.iter().chain(self.axes_mm.iter().flat_map(|a| a.iter())).all(|&v| small(v))
            && lengths.iter().all(|&l| l > 1e-6)
            && volume > 1e-3 * lengths.iter().product::<f64>()
    }

    /// The grid's place as a stack.
    ///
    /// # Errors
    /// [`Fault::Sheared`] where the axes are not at right angles.
    pub(crate) fn place(&self) -> Result<Placed, Fault> {
        let warnings = self.check_angles()?;
        let [row, column, slice] = self.axes_mm.map(|a| a.normalize());
        let flat = [along(row, Vector3::x()), along(column, Vector3::y())];
        let (frame, normal, [x, y]) = match flat {
            [Some(x), Some(y)] => (RigidTransform::identity(), Vector3::z(), [!x, !y]),
            _ => {
                let normal = row.cross(&column).normalize();
                let frame = RigidTransform::from_axes(Point3::origin(), row, normal.cross(&row), normal);
                (frame, normal, [false; 2])
            }
        };
        let turned = [x, y, slice.dot(&normal) < 0.0];
        let n_steps = |axis: usize| if turned[axis] { (self.dims[axis] - 1) as f64 } else { 0.0 };
        let first = (0..3).fold(self.origin, |p, axis| p + self.axes_mm[axis] * n_steps(axis));
        let first = frame.inverse().apply(first);
        let step_mm = self.axes_mm[2].dot(&normal).abs();
        Ok(Placed {
            dims: self.dims,
            turned,
            origin_xy_mm: [first.x, first.y],
            pixel_spacing_xy_mm: [self.axes_mm[0].norm(), self.axes_mm[1].norm()],
            plane_z_mm: (0..self.dims[2]).map(|k| first.z + k as f64 * step_mm).collect(),
            patient_from_stack: frame,
            warnings,
        })
    }

    /// How far the farthest voxels lie from where right angles would put them decides, not the angle alone.
    fn check_angles(&self) -> Result<Vec<Warning>, Fault> {
        let pixel_mm = self.axes_mm[0].norm().min(self.axes_mm[1].norm());
        let units = self.axes_mm.map(|a| a.normalize());
        let pairs = [(0, 1), (0, 2), (1, 2)];
        let off = |&(a, b): &(usize, usize)| {
            let length = self.axes_mm[b].norm() * (self.dims[b] - 1) as f64;
            let cosine = units[a].dot(&units[b]).abs();
            (cosine * length, cosine.min(1.0).asin().to_degrees())
        };
        let (shift_mm, angle_deg) =
            pairs.iter().map(off).fold((0.0, 0.0), |m: (f64, f64), o| if o.0 > m.0 { o } else { m });
        if shift_mm <= SHEAR_PIXELS[0] * pixel_mm {
            return Ok(Vec::new());
        }
        if shift_mm > SHEAR_PIXELS[1] * pixel_mm {
            return Err(Fault::Sheared { angle_deg });
        }
        let text = format!("planes lie up to {shift_mm:.3} mm beside each other; this was ignored");
        Ok(vec![Warning::new("ct.plane_offset", text)])
    }

    /// The largest distance between the places that two grids give to a voxel, mm.
    pub(crate) fn farthest_mm(&self, other: &Self) -> f64 {
        let corner = |grid: &Self, c: usize| {
            let steps = |axis: usize| if c >> axis & 1 == 1 { (self.dims[axis] - 1) as f64 } else { 0.0 };
            (0..3).fold(grid.origin, |p, axis| p + grid.axes_mm[axis] * steps(axis))
        };
        (0..8).map(|c| (corner(self, c) - corner(other, c)).norm()).fold(0.0, f64::max)
    }
}

impl Placed {
    /// Turns values of the file's order into the stack's.
    pub(crate) fn turn<T>(&self, values: &mut [T]) {
        let [columns, rows, _] = self.dims;
        // Reversing everything reverses all three axes; each that must not be is then turned back.
        if self.turned[2] {
            values.reverse();
            values.chunks_exact_mut(columns * rows).for_each(<[T]>::reverse);
        }
        if self.turned[1] {
            for plane in values.chunks_exact_mut(columns * rows) {
                plane.reverse();
                plane.chunks_exact_mut(columns).for_each(<[T]>::reverse);
            }
        }
        if self.turned[0] {
            values.chunks_exact_mut(columns).for_each(<[T]>::reverse);
        }
    }

    /// Distance between neighbouring planes, mm.
    pub(crate) fn step_mm(&self) -> f64 {
        self.plane_z_mm[1] - self.plane_z_mm[0]
    }

    /// The volume of values in the file's order.
    pub(crate) fn into_volume(self, mut hu: Vec<f32>, slab_thickness_mm: f64) -> Volume {
        self.turn(&mut hu);
        Volume {
            dims: self.dims,
            hu: Voxels::new(&hu, self.dims[0] * self.dims[1]),
            origin_xy_mm: self.origin_xy_mm,
            pixel_spacing_xy_mm: self.pixel_spacing_xy_mm,
            plane_z_mm: self.plane_z_mm,
            slab_thickness_mm,
            patient_from_stack: self.patient_from_stack,
        }
    }
}
