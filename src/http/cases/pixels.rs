//! Planes of a CT as pictures.

use super::super::access::Operator;
use super::super::appliance::Appliance;
use super::super::error::Problem;
use super::super::extract::Asked;
use super::super::upload::on_disk;
use super::super::wire::ErrorBody;
use super::routes::{cases, handle};
use crate::app::volume_file::{Across, Planes};
use crate::draw;
use crate::store::Store;
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use std::io;

/// Which pixels are black and which are white, HU: soft tissue and a vessel with contrast medium.
const WINDOW_HU: [f32; 2] = [-200.0, 600.0];

/// What is wanted.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(in crate::http) struct PixelQuery {
    /// Across which axis: `z`, `y` or `x`.
    across: Axis,
    /// What is black, HU.
    low_hu: f32,
    /// What is white, HU.
    high_hu: f32,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Axis {
    X,
    Y,
    Z,
}

impl Default for PixelQuery {
    fn default() -> Self {
        let [low_hu, high_hu] = WINDOW_HU;
        Self { across: Axis::Z, low_hu, high_hu }
    }
}

/// A plane of a volume as PNG, 8-bit grey, a pixel for each voxel. Across `z` a plane of the CT; across `y` and `x` the highest plane on top.
#[utoipa::path(get, path = "/api/v1/volumes/{id}/planes/{index}", tag = "cases",
    params(("id" = String, Path, description = "Name of the volume"), ("index" = usize, Path, description = "Number of the plane, from 0"),
        ("across" = Option<String>, Query, description = "`z` (planes of the CT), `y` (one row of all of them) or `x` (one column)"),
        ("low_hu" = Option<f32>, Query, description = "What is black [default: -200]"),
        ("high_hu" = Option<f32>, Query, description = "What is white [default: 600]")),
    responses((status = 200, content_type = "image/png", body = Vec<u8>), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn plane<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path((id, index)): Path<(String, String)>,
    Asked(query): Asked<PixelQuery>,
) -> Result<Response, Problem> {
    let (cases, id) = (cases(&app)?, handle(&id)?);
    let index = index.parse().map_err(|_no_number| wrong_plane("expected the number of a plane, from 0"))?;
    if query.low_hu >= query.high_hu || !query.low_hu.is_finite() || !query.high_hu.is_finite() {
        let message = "found a window that does not ascend, expected low_hu below high_hu";
        return Err(Problem::bad("http.bad_window", message));
    }
    let png = on_disk(move || picture(&mut cases.0.kept.planes(&id)?, index, query)).await?;
    // Pixels are a patient's: nobody on the way keeps them.
    Ok(([(header::CONTENT_TYPE, "image/png"), (header::CACHE_CONTROL, "no-store")], png).into_response())
}

fn wrong_plane(message: &str) -> Problem {
    Problem::bad("http.no_plane", message)
}

/// Blocks.
fn picture(planes: &mut Planes, index: usize, query: PixelQuery) -> Result<Vec<u8>, Problem> {
    let [nx, ny, _] = planes.dims();
    let (across, width) = match query.across {
        Axis::Z => (Across::Z, nx),
        Axis::Y => (Across::Y, nx),
        Axis::X => (Across::X, ny),
    };
    let hu = planes.cut(across, index).map_err(|e| match e.kind() {
        io::ErrorKind::InvalidInput => wrong_plane(&e.to_string()),
        kind => Problem::inside("reading a volume", &kind),
    })?;
    let grey = |hu: &f32| level(*hu, [query.low_hu, query.high_hu]);
    let pixels: Vec<u8> = match query.across {
        Axis::Z => hu.iter().map(grey).collect(),
        Axis::X | Axis::Y => hu.chunks(width).rev().flatten().map(grey).collect(),
    };
    draw::encode_bytes(&pixels, width, png::ColorType::Grayscale)
        .map_err(|e| Problem::inside("drawing a plane", &e))
}

/// The grey of an intensity.
fn level(hu: f32, [low, high]: [f32; 2]) -> u8 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
    let grey = (255.0 * (hu - low) / (high - low)).round().clamp(0.0, 255.0) as u8;
    grey
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ct::{Volume, Voxels};
    use crate::geom::RigidTransform;

    fn pixels(png: &[u8]) -> (u32, Vec<u8>) {
        let mut reader = png::Decoder::new(io::Cursor::new(png)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        (info.width, bytes)
    }

    #[test]
    fn intensities_become_greys_and_the_highest_plane_lies_on_top() {
        let hu: Vec<f32> = [0.0, 100.0, 200.0, 300.0, 400.0, -500.0, 900.0, 50.0].to_vec();
        let volume = Volume {
            dims: [2, 2, 2],
            hu: Voxels::new(&hu, 4),
            origin_xy_mm: [0.0; 2],
            pixel_spacing_xy_mm: [1.0; 2],
            plane_z_mm: vec![0.0, 1.0],
            slab_thickness_mm: 1.0,
            patient_from_stack: RigidTransform::identity(),
        };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("v");
        std::fs::write(&path, crate::app::volume_file::to_bytes(&volume)).unwrap();
        let mut planes = Planes::open(&path).unwrap();
        let query = |across| PixelQuery { across, low_hu: 0.0, high_hu: 400.0 };
        let shown =
            |planes: &mut Planes, across, index| pixels(&picture(planes, index, query(across)).unwrap());
        assert_eq!(shown(&mut planes, Axis::Z, 0), (2, vec![0, 64, 128, 191]));
        assert_eq!(shown(&mut planes, Axis::Y, 0), (2, vec![255, 0, 0, 64]));
        assert_eq!(shown(&mut planes, Axis::X, 1), (2, vec![0, 32, 64, 191]));
        assert_eq!(picture(&mut planes, 2, query(Axis::Z)).unwrap_err().code, "http.no_plane");
    }
}
