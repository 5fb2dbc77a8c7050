//! Points, closed contours, plane regions with their boolean operations, distances, frames.
//!
//! Everything here is in millimetres. Regions are computed on one integer grid of 10 nm ([`region`]), so that
//! the same input gives the same bytes whatever else lies in the plane.

pub mod contour;
pub mod distance;
pub mod frame;
mod offset;
pub(crate) mod raster;
pub mod region;

pub use contour::{Bounds2, Contour};
pub use distance::SegmentIndex;
pub use frame::RigidTransform;
pub use region::Region;

/// A point in a plane, mm.
pub type Point2 = nalgebra::Point2<f64>;
/// A vector in a plane, mm.
pub type Vector2 = nalgebra::Vector2<f64>;
/// A point in space, mm.
pub type Point3 = nalgebra::Point3<f64>;
/// A vector in space, mm.
pub type Vector3 = nalgebra::Vector3<f64>;
