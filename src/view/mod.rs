//! A mesh to a shaded picture (PNG) from given directions, side by side at one scale, upright along the stack's normal.
//!
//! Parallel projection, so that a length can be read off with the scale bar. A software rasteriser with a depth buffer
//! (`raster`) finds what every pixel sees; `shade` lights it: a key light from the upper left of whoever looks, a weak one
//! from the right, light from everywhere less what near surfaces keep away, darker edges. Each pixel is the mean of
//! four. The letters at the edges of a tile name the patient's sides (A, P, L, R, S, I).
//!
//! A body can be cut open: what lies between whoever looks and the middle of its lumen is left away, so that the lumen
//! is seen; cut material is painted flat. Where branches lie far before each other, the cut steps from one to the other beside
//! their split.
//!
//! Same scene, same bytes, on any number of threads. Cost grows with the picture: about a second a megapixel and core.

mod raster;
mod shade;

use crate::draw::{self, Ink, px};
use crate::geom::{Point2, Point3, RigidTransform, Vector3};
use crate::mesh::TriMesh;
use crate::mesh::colour::{ColourScale, corner_normals};
use crate::progress::{Cancelled, Task};
use raster::{Camera, raster};
use shade::shade;
use tiny_skia::{Color, Pixmap, PremultipliedColorU8};

/// Where the picture is taken from, as seen by the patient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From in front of the patient.
    Front,
    /// From behind.
    Back,
    /// From the patient's left.
    Left,
    /// From the patient's right.
    Right,
    /// From above the head.
    Top,
    /// From below the feet, as a CT plane is held.
    Bottom,
    /// From in front, the left and above.
    Oblique,
}

impl Direction {
    /// All directions.
    pub const ALL: [Self; 7] =
        [Self::Front, Self::Back, Self::Left, Self::Right, Self::Top, Self::Bottom, Self::Oblique];

    /// Its word.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Back => "back",
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "top",
            Self::Bottom => "bottom",
            Self::Oblique => "oblique",
        }
    }

    /// The direction of sight and what is up, in patient coordinates (LPS).
    fn sight_and_up(self) -> (Vector3, Vector3) {
        let up = Vector3::z();
        match self {
            Self::Front => (Vector3::y(), up),
            Self::Back => (-Vector3::y(), up),
            Self::Left => (-Vector3::x(), up),
            Self::Right => (Vector3::x(), up),
            Self::Top => (-Vector3::z(), -Vector3::y()),
            Self::Bottom => (Vector3::z(), -Vector3::y()),
            Self::Oblique => (Vector3::new(-0.55, 0.72, -0.42), up),
        }
    }
}

/// The middle of the lumen at ascending heights, one point a branch. Stack frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Middle {
    /// Height, mm, and the branches' middles.
    pub rows: Vec<(f64, Vec<Point2>)>,
}

/// How the surface is coloured.
#[derive(Debug, Clone)]
pub enum Paint {
    /// Two materials: for each triangle whether it bounds the lumen.
    Skins {
        /// One a triangle.
        is_lumen: Vec<bool>,
    },
    /// By a value at each vertex.
    Values {
        /// One a vertex.
        values: Vec<f64>,
        /// Their colours.
        scale: ColourScale,
        /// What they are, with their unit.
        title: &'static str,
    },
}

/// What is shown. Stack frame.
#[derive(Debug)]
pub struct Scene<'a> {
    /// The closed surface.
    pub mesh: &'a TriMesh,
    /// Its colours.
    pub paint: Paint,
    /// To the patient's frame, for the directions.
    pub patient_from_stack: RigidTransform,
    /// Cut open before this.
    pub cut: Option<Middle>,
}

/// No picture can be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The work was interrupted.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The canvas or the encoder refuses.
    #[error(
        "cannot make a picture of {width} x {height} pixels: {why}; ask for a smaller one, or fewer directions"
    )]
    Picture {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// What they say.
        why: String,
    },
}

const INK: Ink = Ink { line: [40, 44, 52, 255], shade: [255, 255, 255, 190] };
/// Free space round a tile's vessel: beside it for letters, above for them and the name, below for them and the bar.
const SIDE_PX: f64 = 44.0;
const ABOVE_PX: f64 = 74.0;
const BELOW_PX: f64 = 84.0;
/// Room for the scale of colours.
const LEGEND_PX: f64 = 170.0;
/// Least width of a tile: its scale bar and name.
const LEAST_TILE_PX: f64 = 200.0;
/// Samples a pixel and direction.
const SAMPLES: u32 = 2;

/// Draws the scene from all directions; `size_px` is the picture's height.
///
/// # Errors
/// [`Error`].
pub fn render(
    scene: &Scene<'_>,
    from: &[Direction],
    size_px: u32,
    task: &Task<'_>,
) -> Result<Vec<u8>, Error> {
    let stack_from_patient = scene.patient_from_stack.inverse();
    let looks: Vec<Look> = from.iter().map(|&f| Look::of(scene.mesh, f, &stack_from_patient)).collect();
    let height = f64::from(size_px);
    let tallest = looks.iter().map(|l| l.size_mm[1]).fold(1e-6, f64::max);
    let widest: f64 = looks.iter().map(|l| l.size_mm[0]).sum::<f64>().max(1e-6);
    // As high as the picture allows, and no wider than three times as much.
    let px_per_mm = ((height - ABOVE_PX - BELOW_PX) / tallest).min(3.0 * height / widest);
    let normals = corner_normals(scene.mesh);
    let mut tiles = Vec::new();
    for look in &looks {
        let width = (look.size_mm[0] * px_per_mm + 2.0 * SIDE_PX).max(LEAST_TILE_PX);
        let camera = look.camera([width, height], px_per_mm * f64::from(SAMPLES));
        let seen = raster(scene, &camera, task)?;
        task.check()?;
        tiles.push(Tile {
            look,
            width: camera.size[0] / SAMPLES,
            pixels: shade(scene, &normals, &camera, &seen),
        });
    }
    compose(scene, &tiles, size_px, px_per_mm)
}

/// A direction and what it sees of a body.
struct Look {
    from: Direction,
    /// Unit vectors: right, up, away from whoever looks. Stack frame.
    axes: [Vector3; 3],
    middle: Point3,
    size_mm: [f64; 2],
}

impl Look {
    fn of(mesh: &TriMesh, from: Direction, stack_from_patient: &RigidTransform) -> Self {
        let (sight, up) = from.sight_and_up();
        let away = stack_from_patient.rotate(sight.normalize());
        let right = away.cross(&stack_from_patient.rotate(up)).normalize();
        let axes = [right, right.cross(&away), away];
        let range = |axis: Vector3| {
            let along = mesh.vertices.iter().map(|p| p.coords.dot(&axis));
            along.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
        };
        let ranges = axes.map(range).map(|[a, b]| if a <= b { [a, b] } else { [0.0; 2] });
        let middle: Vector3 = (0..3).map(|k| axes[k] * (0.5 * (ranges[k][0] + ranges[k][1]))).sum();
        let size_mm = [ranges[0][1] - ranges[0][0], ranges[1][1] - ranges[1][0]];
        Self { from, axes, middle: middle.into(), size_mm }
    }

    fn camera(&self, [width, height]: [f64; 2], samples_per_mm: f64) -> Camera {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of pixels")]
        let n = |v: f64| v.round() as u32 * SAMPLES;
        let size = [n(width), n(height)];
        let y_middle = ABOVE_PX + 0.5 * (height - ABOVE_PX - BELOW_PX);
        let centre = [0.5 * f64::from(size[0]), y_middle * f64::from(SAMPLES)];
        Camera { axes: self.axes, middle: self.middle, centre, samples_per_mm, size }
    }
}

struct Tile<'a> {
    look: &'a Look,
    width: u32,
    /// One a sample.
    pixels: Vec<[f32; 3]>,
}

fn compose(scene: &Scene<'_>, tiles: &[Tile<'_>], height: u32, px_per_mm: f64) -> Result<Vec<u8>, Error> {
    let legend = if matches!(scene.paint, Paint::Values { .. }) { LEGEND_PX } else { 0.0 };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a constant")]
    let width = tiles.iter().map(|t| t.width).sum::<u32>() + legend as u32;
    let fail = |why: String| Error::Picture { width, height, why };
    let mut canvas = Pixmap::new(width, height).ok_or_else(|| fail("no canvas of this size".into()))?;
    canvas.fill(Color::WHITE);
    let mut left = 0;
    for tile in tiles {
        lay(&mut canvas, tile, left);
        let place = [f64::from(left), f64::from(tile.width), f64::from(height)];
        label(&mut canvas, tile.look, place, scene.patient_from_stack);
        left += tile.width;
    }
    draw::scale_bar(&mut canvas, (16.0, px(f64::from(height) - 16.0)), LEAST_TILE_PX - 80.0, px_per_mm, INK);
    if let Paint::Values { scale, title, .. } = &scene.paint {
        colour_bar(&mut canvas, f64::from(left), f64::from(height), *scale, title);
    }
    draw::encode(&canvas).map_err(|e| fail(e.to_string()))
}

/// Samples to pixels.
fn lay(canvas: &mut Pixmap, tile: &Tile<'_>, left: u32) {
    let (width, row) = (canvas.width() as usize, (tile.width * SAMPLES) as usize);
    let n = SAMPLES as usize;
    for (y, line) in canvas.pixels_mut().chunks_exact_mut(width).enumerate() {
        for (x, pixel) in line[left as usize..(left + tile.width) as usize].iter_mut().enumerate() {
            let mut sum = [0.0_f32; 3];
            for k in 0..n * n {
                let sample = tile.pixels[(n * y + k / n) * row + n * x + k % n];
                sum.iter_mut().zip(sample).for_each(|(s, v)| *s += v);
            }
            let [r, g, b] = sum.map(|s| shade::byte(s / (n * n) as f32));
            *pixel = PremultipliedColorU8::from_rgba(r, g, b, 255).unwrap_or(*pixel);
        }
    }
}

/// The name of the direction and the letters of the patient's sides.
fn label(
    canvas: &mut Pixmap,
    look: &Look,
    [left, width, height]: [f64; 3],
    patient_from_stack: RigidTransform,
) {
    let letter = |v: Vector3| draw::side_letter(patient_from_stack.rotate(v), ["S", "I"]);
    let [right, up, _] = look.axes;
    let unit = 2.6;
    let half = 0.5 * draw::text_width("L", unit);
    let middle = px(left + 0.5 * width);
    let y_middle = px(ABOVE_PX + 0.5 * (height - ABOVE_PX - BELOW_PX)) - 3.0 * unit;
    draw::text(canvas, letter(-right), (px(left + 10.0), y_middle), unit, INK);
    draw::text(canvas, letter(right), (px(left + width - 22.0), y_middle), unit, INK);
    draw::text(canvas, letter(up), (middle - half, 46.0), unit, INK);
    draw::text(canvas, letter(-up), (middle - half, px(height - BELOW_PX + 12.0)), unit, INK);
    let name = look.from.name();
    draw::text(canvas, name, (middle - 0.5 * draw::text_width(name, 2.2), 16.0), 2.2, INK);
}

/// The scale of colours with its ends, its middle and its title.
fn colour_bar(canvas: &mut Pixmap, left: f64, height: f64, scale: ColourScale, title: &str) {
    let (x, top, bottom) = (left + 30.0, ABOVE_PX + 20.0, (height - BELOW_PX).min(ABOVE_PX + 420.0));
    let n = 64;
    for i in 0..n {
        let share = |k: u32| f64::from(k) / f64::from(n);
        let [low, high] = scale.range;
        let [r, g, b] = scale.colour(low + (high - low) * share(i));
        let y = bottom - (bottom - top) * share(i + 1);
        let size = (18.0, px((bottom - top) / f64::from(n)) + 0.5);
        if let Some(rect) = tiny_skia::Rect::from_xywh(px(x), px(y), size.0, size.1) {
            canvas.fill_rect(rect, &draw::paint([r, g, b, 255]), tiny_skia::Transform::identity(), None);
        }
    }
    for part in [0.0, 0.5, 1.0] {
        let value = scale.range[0] + (scale.range[1] - scale.range[0]) * part;
        let y = bottom - (bottom - top) * part;
        draw::text(canvas, &format!("{value:.3}"), (px(x + 26.0), px(y - 6.0)), 2.0, INK);
    }
    for (i, line) in title.split(", ").enumerate() {
        draw::text(canvas, line, (px(left + 14.0), 16.0 + 22.0 * px(i as f64)), 1.7, INK);
    }
}

#[cfg(test)]
mod tests;
