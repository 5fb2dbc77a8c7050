//! Triangles row by row: coarser in its promise (chords within the deflection; what the surface does between them is to be
//! measured), robust where the finer mesher finds no sound mesh.

mod cap;
mod ribbon;
#[cfg(test)]
mod tests;

use super::{Error, Part, Parted, SkinChoice, TriMesh};
use crate::geom::{Contour, Point2, Point3, SegmentIndex};
use crate::progress::Task;
use crate::solid::{Crotch, End, Skin, Slab, Solid, Tube};
use crate::spline::{PatchSurface, SectionCurve};
use ribbon::{Station, between_rings, between_rows};

/// Share of the deflection that a chord along a row may take; the rest is for the rows' own distance.
const ROW_SHARE: f64 = 0.6;
/// Height of a row of equilateral triangles over their side.
const EQUILATERAL: f64 = 0.866;
/// Rows are this much higher than for equilateral triangles: fewer triangles for hardly worse angles.
const ROW_STRETCH: f64 = 1.15;
/// Fewest rows of a slab with a saddle and of one with a crease, and most of either.
const FEWEST_ROWS: [f64; 2] = [4.0, 12.0];
const MOST_ROWS: f64 = 512.0;
/// Intervals, each way, at which it is measured how a slab bends from row to row.
const BEND_SAMPLES: usize = 16;
/// Samples round a section at which curvature is measured.
const CURVATURE_SAMPLES: usize = 128;

/// Meshes a solid row by row, with chords within the deflection.
///
/// # Errors
/// An interruption, or a mesh that is not closed.
pub(super) fn tessellate(
    solid: &Solid,
    skin: SkinChoice,
    deflection_mm: f64,
    task: &Task<'_>,
) -> Result<Parted, Error> {
    let mut mesher = Mesher { mesh: TriMesh::default(), deflection_mm, task };
    let mut rims = mesher.skin(&solid.lumen)?;
    let mut parts = vec![Part::Lumen; mesher.mesh.triangles.len()];
    if let (SkinChoice::All, Some(outer)) = (skin, &solid.outer) {
        // Seen from the material, the lumen's skin faces inward; lumen caps inside the body do, too.
        mesher.mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        rims.iter_mut().for_each(|r| r.is_hole = !r.is_hole);
        let outer_rims = mesher.skin(outer)?;
        rims.extend(outer_rims);
    }
    parts.resize(mesher.mesh.triangles.len(), Part::Outer);
    mesher.caps(rims)?;
    let mut made = Parted { mesh: mesher.mesh, parts, deviation: None };
    made.fill_up(Part::Cap);
    Ok(made)
}

/// The rim of a flat end.
#[derive(Debug, Clone)]
struct RimAt {
    z_mm: f64,
    downward: bool,
    is_hole: bool,
    vertices: Vec<u32>,
}

/// Rings at the ends of a slab's patches, as vertices with their place.
struct SlabRings {
    waist: Vec<u32>,
    daughters: [Vec<u32>; 2],
}

struct Mesher<'a> {
    mesh: TriMesh,
    deflection_mm: f64,
    task: &'a Task<'a>,
}

impl Mesher<'_> {
    fn skin(&mut self, skin: &Skin) -> Result<Vec<RimAt>, Error> {
        let rings = skin.slabs.iter().map(|s| self.slab(s)).collect::<Result<Vec<_>, _>>()?;
        let mut rims = Vec::new();
        for tube in &skin.tubes {
            self.tube(tube, &rings, &mut rims)?;
        }
        Ok(rims)
    }

    fn tube(&mut self, tube: &Tube, rings: &[SlabRings], rims: &mut Vec<RimAt>) -> Result<(), Error> {
        let [low, high] = tube.surface.z_range_mm();
        let heights = self.row_heights(tube);
        let shared = |end: End| match end {
            End::Cap => None,
            End::Waist { slab } => Some(&rings[slab].waist),
            End::Daughter { slab, side } => Some(&rings[slab].daughters[side]),
        };
        let mut below: Option<Vec<Station>> = None;
        for (k, &z) in heights.iter().enumerate() {
            self.task.check()?;
            let end = if k == 0 {
                Some(tube.bottom)
            } else if k + 1 == heights.len() {
                Some(tube.top)
            } else {
                None
            };
            let curve = tube.surface.section(z);
            let row = match end.and_then(shared) {
                Some(ring) => stations_of_ring(&self.mesh, &curve, ring),
                None => self.ring(&curve, z, k % 2 == 1)?,
            };
            if end == Some(End::Cap) {
                let vertices = row.iter().map(|s| s.vertex).collect();
                let z_mm = if k == 0 { low } else { high };
                // A hole of the lumen runs clockwise.
                let outline = row.iter().map(|s| self.mesh.vertices[s.vertex as usize].xy()).collect();
                let is_hole = !Contour::new(outline).is_ccw();
                rims.push(RimAt { z_mm, downward: k == 0, is_hole, vertices });
            }
            if let Some(lower) = &below {
                between_rings(lower, &row, &self.mesh.vertices, &mut self.mesh.triangles);
            }
            below = Some(row);
        }
        Ok(())
    }

    /// New vertices round a section, spaced by the square root of curvature.
    fn ring(&mut self, curve: &SectionCurve, z: f64, staggered: bool) -> Result<Vec<Station>, Error> {
        let spacing = Spacing::of(curve, ROW_SHARE * self.deflection_mm);
        let n = spacing.n_closed;
        let shift = if staggered { 0.5 } else { 0.0 };
        (0..n)
            .map(|i| {
                let u = spacing.at((i as f64 + shift) / n as f64);
                let p = curve.at(u);
                Ok(Station { u, vertex: self.mesh.push(Point3::new(p.x, p.y, z))? })
            })
            .collect()
    }

    /// Heights of the rows of a tube: steps near the points' spacing, less where the branch bends along z.
    fn row_heights(&self, tube: &Tube) -> Vec<f64> {
        let [low, high] = tube.surface.z_range_mm();
        let mut density = vec![0.0];
        let n_samples = (4 * tube.surface.section_z_mm().len()).clamp(16, 4096);
        let step = (high - low) / n_samples as f64;
        for i in 0..n_samples {
            let z = low + (i as f64 + 0.5) * step;
            density.push(density[i] + step / self.row_height(tube, z, [low, high]));
        }
        let whole = density[n_samples];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of rows")]
        let n_rows = (whole.ceil() as usize).max(1);
        let height = |k: usize| {
            let target = whole * k as f64 / n_rows as f64;
            let i = density.partition_point(|&d| d <= target).clamp(1, n_samples);
            let share = (target - density[i - 1]) / (density[i] - density[i - 1]);
            low + step * (i as f64 - 1.0 + share)
        };
        (0..=n_rows)
            .map(|k| {
                if k == 0 {
                    low
                } else if k == n_rows {
                    high
                } else {
                    height(k)
                }
            })
            .collect()
    }

    /// The height of a row at z.
    fn row_height(&self, tube: &Tube, z: f64, [low, high]: [f64; 2]) -> f64 {
        let curve = tube.surface.section(z);
        let spacing = Spacing::of(&curve, ROW_SHARE * self.deflection_mm);
        let side = spacing.length_mm / spacing.n_closed as f64;
        let slopes = tube.surface.section_slope(z).points();
        let lean = slopes.iter().map(|s| 1.0 + s.coords.norm_squared()).sum::<f64>() / slopes.len() as f64;
        // Bending along z from the change of slope over a short step.
        let h = 0.02 * (high - low).min(1.0);
        let (a, b) = ((z - h).max(low), (z + h).min(high));
        let (sa, sb) = (tube.surface.section_slope(a).points(), tube.surface.section_slope(b).points());
        let bend = sa.iter().zip(&sb).map(|(p, q)| (q - p).norm()).fold(0.0, f64::max) / (b - a).max(1e-9);
        let by_bend = (8.0 * (1.0 - ROW_SHARE) * self.deflection_mm / bend.max(1e-9)).sqrt();
        (side * EQUILATERAL * ROW_STRETCH / lean.sqrt()).min(by_bend)
    }

    fn slab(&mut self, slab: &Slab) -> Result<SlabRings, Error> {
        let n = self.slab_rows(slab);
        let [low, high] = slab.w_mm.map(|w| slab.v_of(w));
        let rows = slab.laterals.each_ref().map(|patch| {
            let at = |i: usize| low + (high - low) * i as f64 / n as f64;
            (0..=n).map(|i| row_points(patch, at(i), ROW_SHARE * self.deflection_mm)).collect::<Vec<_>>()
        });
        // Seen along w a merge is mirrored.
        let flip = !slab.upward;
        // Seam vertices: A-P, B-P are the ends of the first lateral's rows, B-Q, A-Q of the second one's.
        let seams: [[Vec<u32>; 2]; 2] = match &slab.crotch {
            Crotch::Saddle(saddle) => {
                let grid = self.saddle_vertices(saddle, &rows, n)?;
                self.saddle_triangles(&grid, flip);
                [
                    [(0..=n).map(|i| grid[0][i]).collect(), (0..=n).map(|i| grid[n - i][n]).collect()],
                    [(0..=n).map(|i| grid[n][n - i]).collect(), (0..=n).map(|i| grid[i][0]).collect()],
                ]
            }
            Crotch::Crease => self.crease_vertices(&rows[0])?,
        };
        let mut first_rows: [Vec<u32>; 2] = Default::default();
        let mut last_rows: [Vec<u32>; 2] = Default::default();
        for side in 0..2 {
            let mut below: Option<Vec<Station>> = None;
            for (i, row) in rows[side].iter().enumerate() {
                let [start, end] = [seams[side][0][i], seams[side][1][i]];
                let stations = self.open_row(row, start, end)?;
                let ids = stations.iter().map(|s| s.vertex).collect();
                if i == 0 {
                    first_rows[side] = ids;
                } else if i == n {
                    last_rows[side] = ids;
                }
                if let Some(lower) = &below {
                    between_rows(lower, &stations, &self.mesh.vertices, flip, &mut self.mesh.triangles);
                }
                below = Some(stations);
            }
        }
        let open_end = |row: &[u32]| row[..row.len() - 1].to_vec();
        let waist = [open_end(&first_rows[0]), open_end(&first_rows[1])].concat();
        Ok(SlabRings { waist, daughters: last_rows.map(|row| open_end(&row)) })
    }

    /// Intervals of the slab's rows, so that the saddle's grid and the laterals keep the deflection from row to row.
    fn slab_rows(&self, slab: &Slab) -> usize {
        let of_laterals = slab.laterals.iter().map(|lateral| sags(lateral)[1]);
        let (worst, fewest) = match &slab.crotch {
            Crotch::Saddle(saddle) => (of_laterals.chain(sags(saddle)).fold(0.0, f64::max), FEWEST_ROWS[0]),
            Crotch::Crease => (of_laterals.fold(0.0, f64::max), FEWEST_ROWS[1]),
        };
        // A chord over one step sags a quarter as much as over two; both directions of a grid add up.
        let n = BEND_SAMPLES as f64 * (worst / (2.0 * self.deflection_mm)).sqrt();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n = n.ceil().clamp(fewest, MOST_ROWS) as usize;
        n
    }

    /// Vertices `[j][i]` of the saddle's grid; its border holds the seams.
    fn saddle_vertices(
        &mut self,
        saddle: &PatchSurface,
        rows: &[Vec<Vec<RowPoint>>; 2],
        n: usize,
    ) -> Result<Vec<Vec<u32>>, Error> {
        let start = |side: usize, i: usize| rows[side][i][0].at;
        let end = |side: usize, i: usize| rows[side][i][rows[side][i].len() - 1].at;
        let place = |i: usize, j: usize| match (i, j) {
            (i, 0) => start(0, i),
            (0, j) => end(1, j),
            (i, j) if i == n => end(0, n - j),
            (i, j) if j == n => start(1, n - i),
            _ => saddle.at(i as f64 / n as f64, j as f64 / n as f64),
        };
        (0..=n).map(|j| (0..=n).map(|i| self.mesh.push(place(i, j))).collect()).collect()
    }

    /// Vertices of the crease, from A and from B up to the apex, as the sides of both laterals.
    fn crease_vertices(&mut self, rows: &[Vec<RowPoint>]) -> Result<[[Vec<u32>; 2]; 2], Error> {
        let from_a = rows.iter().map(|r| self.mesh.push(r[0].at)).collect::<Result<Vec<_>, _>>()?;
        let mut from_b = Vec::with_capacity(rows.len());
        for row in &rows[..rows.len() - 1] {
            from_b.push(self.mesh.push(row[row.len() - 1].at)?);
        }
        from_b.push(from_a[from_a.len() - 1]);
        Ok([[from_a.clone(), from_b.clone()], [from_b, from_a]])
    }

    fn saddle_triangles(&mut self, grid: &[Vec<u32>], flip: bool) {
        let n = grid.len() - 1;
        for j in 0..n {
            for i in 0..n {
                let quad = [grid[j][i], grid[j][i + 1], grid[j + 1][i + 1], grid[j + 1][i]];
                let place = quad.map(|v| self.mesh.vertices[v as usize]);
                let first_diagonal = (place[2] - place[0]).norm() <= (place[3] - place[1]).norm();
                let pair = if first_diagonal { [[0, 1, 2], [0, 2, 3]] } else { [[0, 1, 3], [1, 2, 3]] };
                for t in pair {
                    let t = t.map(|k: usize| quad[k]);
                    self.mesh.triangles.push(if flip { [t[0], t[2], t[1]] } else { t });
                }
            }
        }
    }

    /// The row's inner vertices are new, its ends those of the seams.
    fn open_row(&mut self, row: &[RowPoint], start: u32, end: u32) -> Result<Vec<Station>, Error> {
        let last = row.len() - 1;
        row.iter()
            .enumerate()
            .map(|(k, p)| {
                let vertex = if k == 0 {
                    start
                } else if k == last {
                    end
                } else {
                    self.mesh.push(p.at)?
                };
                Ok(Station { u: p.u, vertex })
            })
            .collect()
    }

    /// Fills all flat ends: each outer rim with the lumen rims at its height that lie in it.
    fn caps(&mut self, rims: Vec<RimAt>) -> Result<(), Error> {
        let outline = |mesh: &TriMesh, rim: &RimAt| {
            Contour::new(rim.vertices.iter().map(|&v| mesh.vertices[v as usize].xy()).collect())
        };
        let (holes, outers): (Vec<_>, Vec<_>) = rims.into_iter().partition(|r| r.is_hole);
        let mut used = vec![false; holes.len()];
        for outer in &outers {
            let border = outline(&self.mesh, outer);
            let mut inside = Vec::new();
            for (k, hole) in holes.iter().enumerate() {
                let same_end = hole.downward == outer.downward && (hole.z_mm - outer.z_mm).abs() < 1e-9;
                if same_end && !used[k] && border.contains(self.mesh.vertices[hole.vertices[0] as usize].xy())
                {
                    used[k] = true;
                    inside.push(hole.vertices.clone());
                }
            }
            cap::fill(&mut self.mesh, &outer.vertices, &inside, outer.downward)?;
        }
        for (hole, _) in holes.iter().zip(used).filter(|(_, used)| !used) {
            // A lumen that ends inside the body: its cap faces the void.
            cap::fill(&mut self.mesh, &hole.vertices, &[], !hole.downward)?;
        }
        Ok(())
    }
}

/// Farthest that a patch is from chords over two steps of its sampling, along u and along v, mm.
fn sags(patch: &PatchSurface) -> [f64; 2] {
    let n = BEND_SAMPLES;
    let at = |[low, high]: [f64; 2], i: usize| low + (high - low) * i as f64 / n as f64;
    let row = |j: usize| -> Vec<Point3> {
        let row = patch.row(at(patch.v_range(), j));
        (0..=n).map(|i| row.at(at(patch.u_range(), i))).collect()
    };
    let rows: Vec<Vec<Point3>> = (0..=n).map(row).collect();
    // Across the chord: how fast the parameter runs along it does not matter.
    let sag = |[a, b, c]: [Point3; 3]| {
        let along = (c - a).try_normalize(1e-12).unwrap_or_default();
        let off = b - a;
        (off - along * off.dot(&along)).norm()
    };
    let along_u = rows.iter().flat_map(|row| row.windows(3).map(|p| sag([p[0], p[1], p[2]])));
    let along_v = rows.windows(3).flat_map(|r| (0..=n).map(move |i| sag([r[0][i], r[1][i], r[2][i]])));
    [along_u.fold(0.0, f64::max), along_v.fold(0.0, f64::max)]
}

/// A point of a lateral patch's row.
#[derive(Debug, Clone, Copy)]
struct RowPoint {
    u: f64,
    at: Point3,
}

/// Points of the row at height w, evenly spaced by arc length, chords within the tolerance.
fn row_points(patch: &PatchSurface, w: f64, tolerance_mm: f64) -> Vec<RowPoint> {
    const SAMPLES: usize = 128;
    let row = patch.row(w);
    let samples: Vec<Point3> = (0..=SAMPLES).map(|i| row.at(i as f64 / SAMPLES as f64)).collect();
    let mut length = vec![0.0];
    for pair in samples.windows(2) {
        length.push(length[length.len() - 1] + (pair[1] - pair[0]).norm());
    }
    let whole = length[SAMPLES];
    let sag = samples.windows(3).map(|s| {
        let chord = (s[2] - s[0]).norm().max(1e-9);
        8.0 * (nalgebra::center(&s[0], &s[2]) - s[1]).norm() / (chord * chord)
    });
    let curvature = sag.fold(0.0, f64::max).min(40.0 * std::f64::consts::PI / whole);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let n = (whole * (curvature / (8.0 * tolerance_mm)).sqrt()).ceil().clamp(4.0, 4096.0) as usize;
    (0..=n)
        .map(|k| {
            let target = whole * k as f64 / n as f64;
            let i = length.partition_point(|&l| l < target).clamp(1, SAMPLES);
            let share = ((target - length[i - 1]) / (length[i] - length[i - 1]).max(1e-12)).clamp(0.0, 1.0);
            let u = if k == n { 1.0 } else { (i as f64 - 1.0 + share) / SAMPLES as f64 };
            RowPoint { u, at: row.at(u) }
        })
        .collect()
}

/// Where the vertices of a shared ring lie on the tube's end section.
fn stations_of_ring(mesh: &TriMesh, curve: &SectionCurve, ring: &[u32]) -> Vec<Station> {
    let section = Contour::new(curve.points());
    let n = section.len() as f64;
    let index = SegmentIndex::try_new(std::slice::from_ref(&section)).expect("a section has edges");
    ring.iter()
        .map(|&vertex| {
            let foot = index.nearest(mesh.vertices[vertex as usize].xy());
            let from = section.points[foot.edge_idx];
            let to = section.points[(foot.edge_idx + 1) % section.len()];
            let share = (foot.point - from).norm() / (to - from).norm().max(1e-12);
            Station { u: ((foot.edge_idx as f64 + share) / n).rem_euclid(1.0), vertex }
        })
        .collect()
}

/// How the points round a section are spaced.
struct Spacing {
    /// Cumulated density at the samples, from 0 to 1.
    cumulated: Vec<f64>,
    length_mm: f64,
    /// Number of points on the closed section.
    n_closed: usize,
}

impl Spacing {
    fn of(curve: &SectionCurve, tolerance_mm: f64) -> Self {
        let n = CURVATURE_SAMPLES;
        let points: Vec<Point2> = (0..n).map(|i| curve.at(i as f64 / n as f64)).collect();
        let at = |i: usize| points[i % n];
        let length_mm: f64 = (0..n).map(|i| (at(i + 1) - at(i)).norm()).sum();
        let mean_curvature = std::f64::consts::TAU / length_mm;
        let curvature = |i: usize| {
            let (a, b, c) = (at(i + n - 1), at(i), at(i + 1));
            let chord = (c - a).norm().max(1e-12);
            8.0 * (nalgebra::center(&a, &c) - b).norm() / (chord * chord)
        };
        // Straight parts still need points, or triangles would become long there.
        let density = |i: usize| curvature(i).max(0.35 * mean_curvature).min(20.0 * mean_curvature).sqrt();
        let densities: Vec<f64> = (0..n).map(density).collect();
        let mut cumulated = vec![0.0];
        for i in 0..n {
            let piece = 0.5 * (densities[i] + densities[(i + 1) % n]) * (at(i + 1) - at(i)).norm();
            cumulated.push(cumulated[i] + piece);
        }
        let whole = cumulated[n];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n_closed = (whole / (8.0 * tolerance_mm).sqrt()).ceil().clamp(8.0, 8192.0) as usize;
        cumulated.iter_mut().for_each(|c| *c /= whole);
        Self { cumulated, length_mm, n_closed }
    }

    /// The parameter u at a fraction of the cumulated density.
    fn at(&self, fraction: f64) -> f64 {
        let n = CURVATURE_SAMPLES;
        let i = self.cumulated.partition_point(|&c| c <= fraction).clamp(1, n);
        let share = (fraction - self.cumulated[i - 1]) / (self.cumulated[i] - self.cumulated[i - 1]);
        (i as f64 - 1.0 + share) / n as f64
    }
}
