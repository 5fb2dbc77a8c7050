//! The solid to triangles: which faces there are, which edges they share, and the whole put together.

use super::cap::{self, Filled, Rim};
use super::chart::{Allowed, Asked, Chart, Finer};
use super::face::{Corner, Face};
use super::slab::{Patch, SlabEdges, mesh_patch, surface};
use super::tube::{MeshedTube, mesh_tube};
use super::{Error, Part, Parted, TriMesh};
use crate::geom::{Contour, Point2, Point3};
use crate::progress::Task;
use crate::solid::{End, Skin, SkinChoice, Slab, Solid};
use crate::spline::TubeSurface;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Least and largest deflection that is accepted, mm: below half a micrometre the file outgrows every memory.
pub const DEFLECTION_MM: [f64; 2] = [0.0005, 5.0];
/// The same in relation to the local size: a fifth leaves eight corners to a circle.
pub const DEFLECTION_RELATIVE: [f64; 2] = [1e-4, 0.2];

/// How far the surface may be from its triangles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Deflection {
    /// The same everywhere.
    Absolute {
        /// Deflection, mm, 0.0005 to 5.
        mm: f64,
    },
    /// In relation to the local size: the radius of the circle with the section's area. In a dome, which ends in
    /// nothing, the size falls no faster than at 45 degrees.
    Relative {
        /// Deflection over size, 0.0001 to 0.2.
        fraction: f64,
    },
}

fn is_within(value: f64, [least, most]: [f64; 2]) -> bool {
    (least..=most).contains(&value)
}

impl Deflection {
    /// Refuses what no mesh is made for.
    pub(super) fn check(self) -> Result<(), Error> {
        match self {
            Self::Absolute { mm } if !is_within(mm, DEFLECTION_MM) => Err(Error::Deflection(mm)),
            Self::Relative { fraction } if !is_within(fraction, DEFLECTION_RELATIVE) => {
                Err(Error::Fraction(fraction))
            }
            _ => Ok(()),
        }
    }

    /// The deflection where edges are this long, mm: on a cylinder of radius r, an edge of length e has a sag of e²/8r.
    pub(super) fn near_mm(self, longest_mm: f64) -> f64 {
        match self {
            Self::Absolute { mm } => mm,
            Self::Relative { fraction } => longest_mm * (fraction / 8.0).sqrt(),
        }
    }

    /// A share of the deflection.
    pub(super) const fn times(self, share: f64) -> Self {
        match self {
            Self::Absolute { mm } => Self::Absolute { mm: share * mm },
            Self::Relative { fraction } => Self::Relative { fraction: share * fraction },
        }
    }
}

/// How to mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tessellation {
    /// Which skins.
    pub skin: SkinChoice,
    /// Farthest that any point of the surface may be from its triangles.
    pub deflection: Deflection,
}

impl Tessellation {
    /// Everywhere the same deflection, mm.
    #[must_use]
    pub const fn within(deflection_mm: f64, skin: SkinChoice) -> Self {
        Self { skin, deflection: Deflection::Absolute { mm: deflection_mm } }
    }
}

/// Meshes a solid once. Every face keeps the deflection; whether faces meet each other is not looked at.
///
/// # Errors
/// [`Error::NotKept`], [`Error::Cap`], [`Error::TooLarge`], [`Error::Cancelled`].
pub(super) fn mesh_once(
    solid: &Solid,
    how: &Tessellation,
    finer: &[Finer],
    task: &Task<'_>,
) -> Result<Parted, Error> {
    let mut made = Parted::default();
    let sides = sides(solid, how.skin);
    let edges: Vec<Vec<SlabEdges>> = sides
        .iter()
        .map(|side| slab_edges(side.skin, how.deflection, finer, &mut made.mesh))
        .collect::<Result<_, _>>()?;
    let jobs: Vec<Job<'_>> =
        sides.iter().zip(&edges).flat_map(|(&side, edges)| jobs(side, edges, finer)).collect();
    let done: Vec<Result<Done, Error>> = jobs.par_iter().map(|job| job.run(how.deflection, task)).collect();
    let mut rims = Vec::new();
    for done in done {
        rims.extend(put(&mut made, done?)?);
    }
    let fill = |region: &cap::Region<'_>| Ok((cap::fill(region, task)?, region.is_void()));
    let caps: Vec<Result<(Filled, bool), Error>> = cap::regions(&rims).par_iter().map(fill).collect();
    for cap in caps {
        let (filled, is_void) = cap?;
        append(&mut made.mesh, filled)?;
        made.fill_up(if is_void { Part::Lumen } else { Part::Cap });
    }
    Ok(made)
}

/// A skin as a side of the body.
#[derive(Debug, Clone, Copy)]
struct Surfaced<'a> {
    skin: &'a Skin,
    /// Whether it encloses a void in the body: seen from the material, it then faces inward.
    is_void: bool,
    part: Part,
}

fn sides(solid: &Solid, choice: SkinChoice) -> Vec<Surfaced<'_>> {
    let lumen = |is_void| Surfaced { skin: &solid.lumen, is_void, part: Part::Lumen };
    match (choice, &solid.outer) {
        (SkinChoice::All, Some(skin)) => {
            vec![lumen(true), Surfaced { skin, is_void: false, part: Part::Outer }]
        }
        _ => vec![lumen(false)],
    }
}

/// The edges of all slabs of a skin, their vertices in the mesh.
fn slab_edges(
    skin: &Skin,
    deflection: Deflection,
    finer: &[Finer],
    mesh: &mut TriMesh,
) -> Result<Vec<SlabEdges>, Error> {
    let sampled = |slab: &Slab| {
        let allowed = Allowed { asked: of_slab(slab, deflection), finer };
        SlabEdges::sampled(slab, &allowed, mesh)
    };
    skin.slabs.iter().map(sampled).collect()
}

/// The faces of a skin: its tubes, then the patches of its slabs.
fn jobs<'a>(side: Surfaced<'a>, edges: &'a [SlabEdges], finer: &'a [Finer]) -> Vec<Job<'a>> {
    let tubes = (0..side.skin.tubes.len()).map(What::Tube);
    let patches = side.skin.slabs.iter().enumerate().flat_map(|(k, slab)| {
        let all = [Patch::Lateral(0), Patch::Lateral(1), Patch::Saddle].into_iter();
        all.filter(|&p| surface(slab, p).is_some()).map(move |p| What::Patch(k, p))
    });
    tubes.chain(patches).map(|what| Job { side, edges, finer, what }).collect()
}

/// Adds a meshed face; returns the rims that it leaves open.
fn put(made: &mut Parted, done: Done) -> Result<Vec<Rim>, Error> {
    let Done { filled, ends, is_void, part } = done;
    let numbers = append(&mut made.mesh, filled)?;
    made.fill_up(part);
    let rim = |(is_bottom, ring): (bool, Vec<u32>)| {
        let vertex = |&v: &u32| (numbers[v as usize], made.mesh.vertices[numbers[v as usize] as usize]);
        let mut rim = Rim { vertices: ring.iter().map(vertex).collect(), is_bottom, is_void };
        // A hole in a skin runs clockwise and bounds the other side.
        rim.is_void ^= !Contour::new(rim.vertices.iter().map(|v| v.1.xy()).collect()).is_ccw();
        rim
    };
    Ok(ends.into_iter().map(rim).collect())
}

/// Adds a face; returns the numbers of its corners.
fn append(mesh: &mut TriMesh, filled: Filled) -> Result<Vec<u32>, Error> {
    let number = |c: &Corner| c.shared.map_or_else(|| mesh.push(c.point), Ok);
    let numbers = filled.corners.iter().map(number).collect::<Result<Vec<_>, _>>()?;
    mesh.triangles.extend(filled.triangles.iter().map(|t| t.map(|v| numbers[v as usize])));
    Ok(numbers)
}

#[derive(Debug, Clone, Copy)]
enum What {
    Tube(usize),
    Patch(usize, Patch),
}

/// A face to mesh.
struct Job<'a> {
    side: Surfaced<'a>,
    edges: &'a [SlabEdges],
    finer: &'a [Finer],
    what: What,
}

/// A meshed face, its triangles as seen from outside the body.
struct Done {
    filled: Filled,
    /// Rings that need a cap, and whether they are at the bottom.
    ends: Vec<(bool, Vec<u32>)>,
    is_void: bool,
    part: Part,
}

impl Job<'_> {
    fn run(&self, deflection: Deflection, task: &Task<'_>) -> Result<Done, Error> {
        task.check()?;
        match self.what {
            What::Tube(tube) => self.tube(tube, deflection, task),
            What::Patch(slab, patch) => self.patch(slab, patch, deflection, task),
        }
    }

    fn tube(&self, tube: usize, deflection: Deflection, task: &Task<'_>) -> Result<Done, Error> {
        let tube = &self.side.skin.tubes[tube];
        let allowed = Allowed { asked: of_tube(&tube.surface, deflection), finer: self.finer };
        let shared = |end: End| match end {
            End::Cap => None,
            End::Waist { slab } => {
                Some(self.edges[slab].waist_ring(&self.side.skin.slabs[slab], &self.side.skin.welds[slab]))
            }
            End::Daughter { slab, side } => Some(self.edges[slab].daughter_ring(
                &self.side.skin.slabs[slab],
                &self.side.skin.welds[slab],
                side,
            )),
        };
        let chart = Chart::of_tube(&tube.surface);
        let rings = [shared(tube.bottom), shared(tube.top)];
        let MeshedTube { face, ends, is_kept } =
            mesh_tube(&chart, &tube.surface.net(), &allowed, rings, task)?;
        let [bottom, top] = ends;
        let capped = [(true, tube.bottom, bottom), (false, tube.top, top)].into_iter();
        let ends = capped
            .filter(|(_, end, ring)| *end == End::Cap && ring.len() > 1)
            .map(|(is_bottom, _, ring)| (is_bottom, ring))
            .collect();
        self.done(face, ends, false, is_kept)
    }

    fn patch(
        &self,
        slab: usize,
        patch: Patch,
        deflection: Deflection,
        task: &Task<'_>,
    ) -> Result<Done, Error> {
        let edges = &self.edges[slab];
        let slab = &self.side.skin.slabs[slab];
        let allowed = Allowed { asked: of_slab(slab, deflection), finer: self.finer };
        let chart = Chart::of_patch(surface(slab, patch).unwrap_or(&slab.laterals[0]));
        let (face, is_kept) = mesh_patch(&chart, slab, patch, edges, &allowed, task)?;
        // Seen along w a merge is mirrored.
        self.done(face, Vec::new(), !slab.upward, is_kept)
    }

    fn not_kept(&self, corners: &[Corner]) -> Error {
        let all = || corners.iter().map(|c| c.point);
        let low = all().fold(Point3::from([f64::INFINITY; 3]), |l, p| l.coords.inf(&p.coords).into());
        let high = all().fold(Point3::from([f64::NEG_INFINITY; 3]), |h, p| h.coords.sup(&p.coords).into());
        let patch = matches!(self.what, What::Patch(..));
        Error::NotKept {
            z_mm: [low.z, high.z],
            patch: patch.then(|| (nalgebra::center(&low, &high), 0.5 * (high - low).norm())),
        }
    }

    fn done(
        &self,
        face: Face<'_>,
        ends: Vec<(bool, Vec<u32>)>,
        is_mirrored: bool,
        is_kept: bool,
    ) -> Result<Done, Error> {
        let Face { corners, mut triangles, .. } = face;
        if !is_kept {
            return Err(self.not_kept(&corners));
        }
        if self.side.is_void != is_mirrored {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        Ok(Done {
            filled: Filled { corners, triangles },
            ends,
            is_void: self.side.is_void,
            part: self.side.part,
        })
    }
}

/// Radius of the circle with the area of a closed polyline.
fn equivalent_radius_mm(points: Vec<Point2>) -> f64 {
    (Contour::new(points).signed_area_mm2().abs() / std::f64::consts::PI).sqrt()
}

fn of_fraction(fraction: f64, size_mm: f64) -> f64 {
    (fraction * size_mm).max(DEFLECTION_MM[0])
}

/// The deflection allowed in a slab: by its smaller daughter.
fn of_slab(slab: &Slab, deflection: Deflection) -> Asked {
    let fraction = match deflection {
        Deflection::Absolute { mm } => return Asked::Everywhere(mm),
        Deflection::Relative { fraction } => fraction,
    };
    let radius_mm = |side: usize| {
        let row = slab.laterals[side].row(slab.v_of(slab.w_mm[1]));
        equivalent_radius_mm((0..64).map(|i| row.at(f64::from(i) / 64.0).xy()).collect())
    };
    Asked::Everywhere(of_fraction(fraction, radius_mm(0).min(radius_mm(1))))
}

/// The deflection allowed on a tube.
fn of_tube(surface: &TubeSurface, deflection: Deflection) -> Asked {
    let fraction = match deflection {
        Deflection::Absolute { mm } => return Asked::Everywhere(mm),
        Deflection::Relative { fraction } => fraction,
    };
    let heights = surface.section_z_mm();
    let mut size: Vec<(f64, f64)> =
        heights.iter().map(|&z| (z, equivalent_radius_mm(surface.section(z).points()))).collect();
    for k in 1..size.len() {
        size[k].1 = size[k].1.max(size[k - 1].1 - (size[k].0 - size[k - 1].0));
    }
    for k in (1..size.len()).rev() {
        size[k - 1].1 = size[k - 1].1.max(size[k].1 - (size[k].0 - size[k - 1].0));
    }
    size.iter_mut().for_each(|row| row.1 = of_fraction(fraction, row.1));
    Asked::ByHeight(size)
}
