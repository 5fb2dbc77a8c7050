//! Rigid transforms between the frames patient (DICOM LPS), stack and bed.
//!
//! A transform is named after where it leads and where it comes from: `stack_from_patient` applied to a
//! point in patient coordinates gives the point in the stack's.

use super::{Point3, Vector3};
use nalgebra::{Isometry3, Matrix3, Matrix4, Rotation3, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// A rotation and a translation, mm. Serialised as a 4 x 4 matrix of 16 numbers, row by row.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<f64>", into = "Vec<f64>")]
pub struct RigidTransform(Isometry3<f64>);

/// The 16 numbers are no rigid transform.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// The number of entries is wrong.
    #[error("a transform needs 16 numbers, row by row; found {0}")]
    Length(usize),
    /// The upper left 3 x 3 block is no rotation, or the last row is not 0 0 0 1.
    #[error("the matrix is not a rigid transform: its rotation part is off by {0:.2e}")]
    NotRigid(f64),
}

impl RigidTransform {
    /// Every point stays where it is.
    #[must_use]
    pub fn identity() -> Self {
        Self(Isometry3::identity())
    }

    /// A shift without rotation, mm.
    #[must_use]
    pub fn translation(by: Vector3) -> Self {
        Self(Isometry3::from_parts(Translation3::from(by), UnitQuaternion::identity()))
    }

    /// The transform that carries the unit axes to the given right-handed orthonormal ones and the origin to
    /// `origin`.
    #[must_use]
    pub fn from_axes(origin: Point3, x: Vector3, y: Vector3, z: Vector3) -> Self {
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
        Self(Isometry3::from_parts(
            Translation3::from(origin.coords),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ))
    }

    /// Whether the transform moves no point by more than rounding.
    #[must_use]
    pub fn is_identity(&self) -> bool {
        (self.matrix() - Matrix4::identity()).abs().max() < 1e-12
    }

    /// Carries a point.
    #[must_use]
    pub fn apply(&self, p: Point3) -> Point3 {
        self.0 * p
    }

    /// Carries a direction: rotates it.
    #[must_use]
    pub fn rotate(&self, v: Vector3) -> Vector3 {
        self.0.rotation * v
    }

    /// The way back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self(self.0.inverse())
    }

    /// First `inner`, then `self`.
    #[must_use]
    pub fn after(&self, inner: &Self) -> Self {
        Self(self.0 * inner.0)
    }

    /// The 4 x 4 matrix.
    #[must_use]
    pub fn matrix(&self) -> Matrix4<f64> {
        self.0.to_homogeneous()
    }
}

impl From<RigidTransform> for Vec<f64> {
    fn from(transform: RigidTransform) -> Self {
        transform.matrix().transpose().as_slice().to_vec()
    }
}

impl TryFrom<Vec<f64>> for RigidTransform {
    type Error = FrameError;

    fn try_from(rows: Vec<f64>) -> Result<Self, FrameError> {
        if rows.len() != 16 {
            return Err(FrameError::Length(rows.len()));
        }
        let matrix = Matrix4::from_row_slice(&rows);
        let rotation: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into();
        let last_row = matrix.row(3) - nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0);
        let fault = (rotation * rotation.transpose() - Matrix3::identity()).abs().max()
            + (rotation.determinant() - 1.0).abs()
            + last_row.abs().max();
        // 1e-6 is what the decimal cosines of DICOM files reach.
        if fault.is_nan() || fault >= 1e-6 {
            return Err(FrameError::NotRigid(fault));
        }
        let origin = Point3::new(matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]);
        let column = |i: usize| -> Vector3 { rotation.column(i).into() };
        Ok(Self::from_axes(origin, column(0), column(1), column(2)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_numbers_there_and_back() {
        let t =
            RigidTransform::from_axes(Point3::new(1.0, 2.0, 3.0), Vector3::y(), Vector3::z(), Vector3::x());
        let rows: Vec<f64> = t.into();
        let back = RigidTransform::try_from(rows).unwrap();
        assert!((back.apply(Point3::new(5.0, 6.0, 7.0)) - Point3::new(8.0, 7.0, 9.0)).norm() < 1e-12);
        assert!(t.inverse().after(&t).is_identity());
    }

    #[test]
    fn a_mirror_is_refused() {
        let mut rows: Vec<f64> = RigidTransform::identity().into();
        rows[0] = -1.0;
        assert!(matches!(RigidTransform::try_from(rows), Err(FrameError::NotRigid(_))));
    }
}
