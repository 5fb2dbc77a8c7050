//! The skins of a solid to faces.
//!
//! Each end of a tube is a ring, cut into edges at the tube's seam and at the corners of the patches that meet it. Tubes
//! and patches are then faces over those edges, the seams of the slabs and the seams of the tubes.

use super::caps::{Rim, caps};
use super::{Body, Brep, Coedge, Edge, Face, Loop, Shell, Surface, Vertex};
use crate::geom::Point3;
use crate::solid::{Crotch, End, Skin, SkinChoice, Solid, Tube, Weld};
use crate::spline::{Curve, Side};

/// Edges round the end of a tube, from the seam u = 0 once round.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    /// Where each edge begins, its index; the next one's start is its end, the last one ends at u = 1.
    pub(super) pieces: Vec<(f64, usize)>,
    /// The vertex on the tube's seam.
    pub(super) seam: usize,
    pub(super) z_mm: f64,
}

/// A piece of a ring with the range of u it covers.
type Piece = (usize, [f64; 2]);

impl Ring {
    /// All its edges with their ranges, from u = 0 to u = 1.
    pub(super) fn all(&self) -> Vec<Piece> {
        let end = |i: usize| self.pieces.get(i + 1).map_or(1.0, |p| p.0);
        self.pieces.iter().enumerate().map(|(i, p)| (p.1, [p.0, end(i)])).collect()
    }

    /// The edges from u = a to u = b, b at most one turn farther; ranges count on beyond 1.
    fn between(&self, a: f64, b: f64) -> Vec<Piece> {
        let once = self.all();
        let next = once.iter().map(|&(e, [s, t])| (e, [s + 1.0, t + 1.0]));
        let middle = |[s, t]: [f64; 2]| 0.5 * (s + t);
        once.iter().copied().chain(next).filter(|(_, r)| middle(*r) > a && middle(*r) < b).collect()
    }
}

impl Brep {
    /// The boundary of a solid, or of its lumen alone, closed by its caps.
    #[must_use]
    pub fn of(solid: &Solid, skin: SkinChoice) -> Self {
        let mut brep = Self::default();
        let mut rims = Vec::new();
        match (skin, &solid.outer) {
            (SkinChoice::All, Some(outer)) => {
                brep.add_skin(&solid.lumen, true, &mut rims);
                brep.add_skin(outer, false, &mut rims);
            }
            _ => brep.add_skin(&solid.lumen, false, &mut rims),
        }
        let faces = caps(&brep, &rims);
        brep.faces.extend(faces);
        brep.bodies = brep.bodies();
        brep
    }

    fn vertex(&mut self, point: Point3) -> usize {
        self.vertices.push(Vertex { point });
        self.vertices.len() - 1
    }

    fn edge(&mut self, curve: Curve, start: usize, end: usize) -> usize {
        self.edges.push(Edge { curve, start, end });
        self.edges.len() - 1
    }

    /// Adds tubes and patches of a skin, turned inside out where `is_reversed`.
    fn add_skin(&mut self, skin: &Skin, is_reversed: bool, rims: &mut Vec<Rim>) {
        let corners: Vec<[usize; 4]> = (0..skin.slabs.len()).map(|i| self.corners(skin, i)).collect();
        let mut rings = Vec::with_capacity(skin.tubes.len());
        for (idx, tube) in skin.tubes.iter().enumerate() {
            let ends = [tube.bottom, tube.top].map(|end| marks(skin, &corners, idx, end));
            let z = tube.surface.z_range_mm();
            let pair = [0, 1].map(|k| self.ring(tube, z[k], &ends[k]));
            self.tube(tube, &pair, is_reversed);
            for (k, end) in [tube.bottom, tube.top].into_iter().enumerate() {
                if end == End::Cap {
                    rims.push(Rim { ring: pair[k].clone(), is_top: k == 1, is_reversed });
                }
            }
            rings.push(pair);
        }
        for (i, corners) in corners.into_iter().enumerate() {
            let seams = self.seams(skin, i, corners);
            self.slab(skin, i, seams, &rings, is_reversed);
        }
    }

    /// Vertices A, B, P, Q of a slab.
    fn corners(&mut self, skin: &Skin, slab: usize) -> [usize; 4] {
        let [first, second] = &skin.slabs[slab].laterals;
        let (ap, bp) = (first.border_column(Side::First).ends(), first.border_column(Side::Last).ends());
        let [a, b, p] = [ap[0], bp[0], ap[1]].map(|point| self.vertex(point));
        let q = match skin.slabs[slab].crotch {
            Crotch::Saddle(_) => self.vertex(second.border_column(Side::First).ends()[1]),
            Crotch::Crease => p,
        };
        [a, b, p, q]
    }

    /// The ring at an end of a tube, with vertices at the given parameters and on the seam.
    fn ring(&mut self, tube: &Tube, z_mm: f64, marks: &[(f64, usize)]) -> Ring {
        let section = tube.surface.section(z_mm);
        let mut stops: Vec<(f64, usize)> = marks.to_vec();
        if !stops.iter().any(|s| s.0 <= 0.0) {
            let on_seam = section.arc([0.0, 1.0], z_mm).ends()[0];
            stops.push((0.0, self.vertex(on_seam)));
        }
        stops.sort_by(|a, b| a.0.total_cmp(&b.0));
        let n = stops.len();
        let pieces = (0..n)
            .map(|i| {
                let (from, start) = stops[i];
                let (to, end) = stops.get(i + 1).copied().unwrap_or((1.0, stops[0].1));
                (from, self.edge(section.arc([from, to], z_mm), start, end))
            })
            .collect();
        Ring { pieces, seam: stops[0].1, z_mm }
    }

    fn tube(&mut self, tube: &Tube, [bottom, top]: &[Ring; 2], is_reversed: bool) {
        let surface = tube.surface.clamped();
        let seam = self.edge(surface.border_column(Side::First), bottom.seam, top.seam);
        let [low, high] = surface.v_range();
        let round = |ring: &Ring, v: f64, is_forward: bool| {
            let coedge = move |(edge, [a, b]): Piece| Coedge { edge, is_forward, trace: [[a, v], [b, v]] };
            ring.all().into_iter().map(coedge).collect::<Vec<_>>()
        };
        let mut coedges = round(bottom, low, true);
        coedges.push(Coedge { edge: seam, is_forward: true, trace: [[1.0, low], [1.0, high]] });
        coedges.extend(round(top, high, false).into_iter().rev());
        coedges.push(Coedge { edge: seam, is_forward: false, trace: [[0.0, low], [0.0, high]] });
        self.face(Surface::Tube(surface), coedges, !is_reversed);
    }

    /// Adds a face whose outer loop is given as it runs round the surface's own normal.
    fn face(&mut self, surface: Surface, mut coedges: Vec<Coedge>, is_outward: bool) {
        if !is_outward {
            coedges.reverse();
            coedges.iter_mut().for_each(|c| c.is_forward = !c.is_forward);
        }
        self.faces.push(Face { surface, is_outward, loops: vec![Loop { coedges }] });
    }

    /// Edges A-P, B-P, A-Q, B-Q; at a crease the last two are the first two.
    fn seams(&mut self, skin: &Skin, slab: usize, [a, b, p, q]: [usize; 4]) -> [usize; 4] {
        let slab = &skin.slabs[slab];
        let [first, second] = &slab.laterals;
        let ap = self.edge(first.border_column(Side::First), a, p);
        let bp = self.edge(first.border_column(Side::Last), b, p);
        match slab.crotch {
            Crotch::Saddle(_) => {
                let bq = self.edge(second.border_column(Side::First), b, q);
                let aq = self.edge(second.border_column(Side::Last), a, q);
                [ap, bp, aq, bq]
            }
            Crotch::Crease => [ap, bp, ap, bp],
        }
    }

    fn slab(
        &mut self,
        skin: &Skin,
        idx: usize,
        [ap, bp, aq, bq]: [usize; 4],
        rings: &[[Ring; 2]],
        is_reversed: bool,
    ) {
        let (slab, weld) = (&skin.slabs[idx], &skin.welds[idx]);
        // Seen along w a merge is mirrored.
        let is_outward = slab.upward != is_reversed;
        let ring = |of: usize| {
            let tube = &skin.tubes[weld.tubes[of]];
            let end = ends_of(idx)[of];
            &rings[weld.tubes[of]][usize::from(tube.bottom != end)]
        };
        for (side, lateral) in slab.laterals.iter().enumerate() {
            let ([left, right], [from, to]) = if side == 0 {
                ([ap, bp], weld.waist_u)
            } else {
                ([bq, aq], [weld.waist_u[1], weld.waist_u[0]])
            };
            let to = if to > from { to } else { to + 1.0 };
            let p = weld.daughter_u[side];
            let [low, high] = lateral.v_range();
            let row = |ring: &Ring, [a, b]: [f64; 2], v: f64, is_forward: bool| -> Vec<Coedge> {
                let u = |at: f64| ((at - a) / (b - a)).clamp(0.0, 1.0);
                let coedge =
                    |(edge, [s, t]): Piece| Coedge { edge, is_forward, trace: [[u(s), v], [u(t), v]] };
                ring.between(a, b).into_iter().map(coedge).collect()
            };
            let mut coedges = row(ring(0), [from, to], low, true);
            coedges.push(Coedge { edge: right, is_forward: true, trace: [[1.0, low], [1.0, high]] });
            coedges.extend(row(ring(1 + side), [p, p + 1.0], high, false).into_iter().rev());
            coedges.push(Coedge { edge: left, is_forward: false, trace: [[0.0, low], [0.0, high]] });
            self.face(Surface::Lateral(lateral.clone()), coedges, is_outward);
        }
        if let Crotch::Saddle(saddle) = &slab.crotch {
            // Corners A (0, 0), P (1, 0), B (1, 1), Q (0, 1).
            let coedges = vec![
                Coedge { edge: ap, is_forward: true, trace: [[0.0, 0.0], [1.0, 0.0]] },
                Coedge { edge: bp, is_forward: false, trace: [[1.0, 1.0], [1.0, 0.0]] },
                Coedge { edge: bq, is_forward: true, trace: [[1.0, 1.0], [0.0, 1.0]] },
                Coedge { edge: aq, is_forward: false, trace: [[0.0, 0.0], [0.0, 1.0]] },
            ];
            self.face(Surface::Saddle(saddle.clone()), coedges, is_outward);
        }
    }

    /// Groups of faces that hang together by edges, each ascending, in the order of their first faces.
    pub(super) fn components(&self, takes_part: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
        let n = self.faces.len();
        let mut root: Vec<usize> = (0..n).collect();
        fn find(root: &mut [usize], mut i: usize) -> usize {
            while root[i] != i {
                root[i] = root[root[i]];
                i = root[i];
            }
            i
        }
        let mut user: Vec<Option<usize>> = vec![None; self.edges.len()];
        for (i, face) in self.faces.iter().enumerate().filter(|(i, _)| takes_part(*i)) {
            for coedge in face.loops.iter().flat_map(|l| &l.coedges) {
                let Some(slot) = user.get_mut(coedge.edge) else { continue };
                let other = *slot.get_or_insert(i);
                let (a, b) = (find(&mut root, i), find(&mut root, other));
                root[a.max(b)] = a.min(b);
            }
        }
        let mut groups: Vec<Vec<usize>> = vec![Vec::new(); n];
        for i in (0..n).filter(|&i| takes_part(i)) {
            groups[find(&mut root, i)].push(i);
        }
        groups.retain(|g| !g.is_empty());
        groups
    }

    /// Shells by their faces: those that enclose a negative volume are hollows of the smallest body around them.
    fn bodies(&self) -> Vec<Body> {
        let shells: Vec<(f64, Shell)> = self
            .components(|_| true)
            .into_iter()
            .map(|faces| (self.volume_of_mm3(&faces), Shell { faces }))
            .collect();
        let (outer, hollow): (Vec<_>, Vec<_>) = shells.into_iter().partition(|s| s.0 > 0.0);
        let mut order: Vec<usize> = (0..outer.len()).collect();
        order.sort_by(|&a, &b| outer[a].0.total_cmp(&outer[b].0));
        let mut bodies: Vec<Body> =
            outer.iter().map(|(_, shell)| Body { outer: shell.clone(), voids: Vec::new() }).collect();
        for (_, shell) in hollow {
            let around = order.iter().copied().find(|&b| self.holds(&outer[b].1, &shell));
            match around.and_then(|b| bodies.get_mut(b)) {
                Some(body) => body.voids.push(shell),
                // Not inside anything: the check says so.
                None => bodies.push(Body { outer: shell, voids: Vec::new() }),
            }
        }
        bodies
    }
}

fn ends_of(slab: usize) -> [End; 3] {
    [End::Waist { slab }, End::Daughter { slab, side: 0 }, End::Daughter { slab, side: 1 }]
}

/// The corners on the ring at an end of a tube.
fn marks(skin: &Skin, corners: &[[usize; 4]], tube: usize, end: End) -> Vec<(f64, usize)> {
    let Some((slab, of)) = (match end {
        End::Cap => None,
        End::Waist { slab } => Some((slab, 0)),
        End::Daughter { slab, side } => Some((slab, 1 + side)),
    }) else {
        return Vec::new();
    };
    let Weld { tubes, waist_u, daughter_u } = skin.welds[slab];
    debug_assert_eq!(tubes[of], tube);
    let [a, b, p, q] = corners[slab];
    match of {
        0 => vec![(waist_u[0], a), (waist_u[1], b)],
        1 => vec![(daughter_u[0], p)],
        _ => vec![(daughter_u[1], q)],
    }
}
