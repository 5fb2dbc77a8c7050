//! Ribs: what keeps slender branches from swaying under the nozzle, and breaks away like supports.
//!
//! A branch is free from its last joint upward: the bed, the place where it parted from another, a strut. As a beam held at its
//! foot its end gives way to a force F across it by F l³ / (3 E I). A tube whose wall is an eighth of its width w, s times as
//! high as wide, gives way by 10 F s³ / (E w): at s = 6 one of ABS (2000 N/mm²), 8 mm wide, by 0.13 mm per newton, a third of
//! a bead. So a branch is held where it has risen above its joint by more than the profile's slenderness times its width (the
//! mean of the least widths of its sections); from there on each half of that, for a strut holds and does not clamp.
//!
//! A strut is a bar across the air, a bead wide and some layers high, narrower where it touches. It leads to the nearest other
//! branch within the profile's span, or to a post beside: a hollow cone on the bed, by the same slenderness as wide at its foot as
//! it needs to be, upright on the side of the branch. Struts are laid after the part, so that their ends have walls to hold on to;
//! the lowest layer spans the air, the others lie on it. Nothing of all this lies in the lumen, or nearer than the air of supports
//! to anything but what it holds. Where no place is found it is told.
//!
//! Not done: a strut holds along itself; across it only so far as what it leads to is steady. Cost: a few distance queries for
//! each layer and place that is tried.

mod scene;

use super::BeadKind;
use super::fill::{FillParams, Path, Role, Vertex};
use super::supports::Support;
use crate::geom::distance::nearest_on_segment;
use crate::geom::{Contour, Point2, Region, Vector2};
use crate::profile::Profile;
use crate::slice::Layer;
use scene::{Axis, Part, Post, Scene, Strut, Want};

/// Over so much of its end a strut is narrow, mm.
const CONTACT_MM: f64 = 1.0;
/// Width of a strut, in widths of a bead.
const STRUT_WIDTHS: f64 = 1.5;
/// Loops of a post on the bed.
const POST_LOOPS: usize = 3;
/// Corners of a post's loop.
const POST_CORNERS: usize = 72;
/// The strut to a post leads away from its middle by no less than this cosine.
const POST_COS: f64 = 0.3;

/// The ribs in one layer.
#[derive(Debug, Clone, Default)]
pub(super) struct Rib {
    posts: Vec<Circle>,
    struts: Vec<Line>,
}

/// Where a post's bead runs.
#[derive(Debug, Clone, Copy)]
struct Circle {
    centre: Point2,
    radius_mm: f64,
}

/// Where a strut's bead runs, and whether its second end is at the part, too.
#[derive(Debug, Clone, Copy)]
struct Line {
    from: Point2,
    to: Point2,
    to_part: bool,
}

impl Rib {
    /// What the posts stand on.
    pub(super) fn footprint(&self, width_mm: f64) -> Region {
        let disc = |c: &Circle| {
            let outline = Contour::circle(c.centre, c.radius_mm + width_mm / 2.0, POST_CORNERS);
            Region::new(vec![outline])
        };
        Region::union_all(&self.posts.iter().map(disc).collect::<Vec<_>>())
    }

    /// The loops of the posts.
    pub(super) fn posts(&self, layer: usize, params: &FillParams) -> Vec<Path> {
        let n_loops = if layer == 0 { POST_LOOPS } else { 1 };
        let ring = |(post, i): (&Circle, usize)| {
            let radius_mm = post.radius_mm - i as f64 * params.pitch_mm();
            (radius_mm > params.width_mm).then(|| ring(Circle { radius_mm, ..*post }, params.width_mm))
        };
        let loops = self.posts.iter().flat_map(|post| (0..n_loops).map(move |i| (post, i)));
        loops.filter_map(ring).collect()
    }

    /// The bars.
    pub(super) fn struts(&self, params: &FillParams) -> Vec<Path> {
        self.struts.iter().map(|line| line.path(params)).collect()
    }
}

fn ring(circle: Circle, width_mm: f64) -> Path {
    let outline = Contour::circle(circle.centre, circle.radius_mm, POST_CORNERS);
    let vertices = outline.points.into_iter().map(|at| Vertex { at, width_mm, room_mm: 0.0 });
    Path { kind: BeadKind::SupportMaterial, role: Role::Outer, closed: true, vertices: vertices.collect() }
}

impl Line {
    fn length_mm(&self) -> f64 {
        (self.to - self.from).norm()
    }

    fn distance_mm(&self, p: Point2) -> f64 {
        (nearest_on_segment(p, self.from, self.to) - p).norm()
    }

    fn crosses(&self, other: &Self) -> bool {
        let sides = |line: &Self, p: Point2| (line.to - line.from).perp(&(p - line.from)) > 0.0;
        sides(self, other.from) != sides(self, other.to) && sides(other, self.from) != sides(other, self.to)
    }

    fn path(&self, params: &FillParams) -> Path {
        let [narrow_mm, widest_mm] = params.limits_mm;
        let wide_mm = strut_mm(params.width_mm, widest_mm);
        let contact_mm = CONTACT_MM.min(self.length_mm() / 3.0);
        let along = (self.to - self.from) / self.length_mm();
        let end_mm = if self.to_part { narrow_mm } else { wide_mm };
        let vertices = [
            (self.from, narrow_mm),
            (self.from + along * contact_mm, wide_mm),
            (self.to - along * contact_mm, wide_mm),
            (self.to, end_mm),
        ];
        let vertex = |(at, width_mm)| Vertex { at, width_mm, room_mm: 0.0 };
        let vertices = vertices.map(vertex).to_vec();
        Path { kind: BeadKind::Rib, role: Role::Raster, closed: false, vertices }
    }
}

/// Width of a strut between its contacts, mm.
fn strut_mm(width_mm: f64, widest_mm: f64) -> f64 {
    (STRUT_WIDTHS * width_mm).min(widest_mm).max(width_mm)
}

/// The ribs of all layers, and the places that want one and have no room for it: the layer, and where.
pub(super) fn ribs(
    layers: &[Layer],
    placed: &[(Region, Region)],
    columns: &[Support],
    profile: &Profile,
) -> (Vec<Rib>, Vec<(usize, Point2)>) {
    if !profile.print.ribs {
        return (Vec::new(), Vec::new());
    }
    let scene = Scene::of(layers, placed, columns, profile);
    let parts = scene.parts();
    let wants: Vec<Vec<Want>> = parts.iter().map(|part| scene.wants(part)).collect();
    let mut plan = Plan { held_mm: vec![Vec::new(); parts.len()], ..Plan::default() };
    for (part, wants) in parts.iter().zip(&wants) {
        wants.iter().for_each(|want| plan.link(want, part, &parts, &scene));
    }
    let mut missing = Vec::new();
    for (part, wants) in parts.iter().zip(&wants) {
        let open: Vec<Want> =
            wants.iter().filter(|want| !plan.is_held(part, want, &scene)).copied().collect();
        let mut open = &open[..];
        while let [first, ..] = open {
            let n_held = plan.post(part, open, &scene);
            if n_held == 0 {
                missing.push((first.layer, scene.island(part, first.layer).outline.centroid()));
            }
            open = &open[n_held.max(1)..];
        }
    }
    (plan.layers(&scene), missing)
}

/// What has been found so far.
#[derive(Default)]
struct Plan {
    struts: Vec<Strut>,
    posts: Vec<Post>,
    /// Heights at which each part is held, mm.
    held_mm: Vec<Vec<f64>>,
}

impl Plan {
    /// Whether a strut holds a part near enough to where it is to be held.
    fn is_held(&self, part: &Part, want: &Want, scene: &Scene) -> bool {
        let z_mm = scene.levels[want.layer].top_mm;
        self.held_mm[part.idx].iter().any(|held| (held - z_mm).abs() <= want.within_mm)
    }

    /// Holds a part by the nearest other one that a strut can lead to.
    fn link(&mut self, want: &Want, part: &Part, parts: &[Part], scene: &Scene) {
        if self.is_held(part, want, scene) {
            return;
        }
        let here = scene.island(part, want.layer);
        let is_there = |other: &&Part| {
            let layers = other.first..other.first + other.islands.len();
            other.idx != part.idx && layers.contains(&want.layer)
        };
        let pair = |other: &Part| {
            let there = Some(scene.island(other, want.layer)).filter(|there| scene.is_body(there))?;
            let (from, to) = here.nearest_pair(there, scene.span_mm)?;
            Some((Axis::between(from, to, true), other.idx))
        };
        let mut pairs: Vec<(Axis, usize)> = parts.iter().filter(is_there).filter_map(pair).collect();
        pairs.sort_by(|a, b| a.0.length_mm.total_cmp(&b.0.length_mm));
        let strut = |(axis, other): (Axis, usize)| {
            let strut = scene.strut(want.layer, &axis)?;
            self.is_free(&strut, scene).then_some((strut, other))
        };
        if let Some((strut, other)) = pairs.into_iter().find_map(strut) {
            let z_mm = scene.levels[want.layer].top_mm;
            [part.idx, other].iter().for_each(|held| self.held_mm[*held].push(z_mm));
            self.struts.push(strut);
        }
    }

    /// Holds a part by a post, at as many of these places as one post can, from the first on; gives how many they are.
    fn post(&mut self, part: &Part, wants: &[Want], scene: &Scene) -> usize {
        let mut best: Option<(Post, Vec<Strut>)> = None;
        for (near, back) in scene.places(scene.island(part, wants[0].layer)) {
            let least = best.as_ref().map_or(0, |(_, struts)| struts.len());
            let mut struts = self.struts_to(near, back, part, wants, scene);
            while struts.len() > least {
                let post = Post { near, back, last: struts[struts.len() - 1].last() };
                if self.has_room(&post, scene) {
                    best = Some((post, struts));
                    break;
                }
                struts.pop();
            }
            if best.as_ref().is_some_and(|(_, struts)| struts.len() == wants.len()) {
                break;
            }
        }
        let Some((post, struts)) = best else { return 0 };
        let n_held = struts.len();
        self.posts.push(post);
        self.struts.extend(struts);
        n_held
    }

    /// The struts from a part to a post that is upright at `near`, as far up as each has one.
    fn struts_to(
        &self,
        near: Point2,
        back: Vector2,
        part: &Part,
        wants: &[Want],
        scene: &Scene,
    ) -> Vec<Strut> {
        let strut = |want: &Want| {
            let skin = scene.island(part, want.layer).index.nearest(near).point;
            let axis = Axis::between(skin, near, false);
            let strut = scene.strut(want.layer, &axis).filter(|strut| self.is_free(strut, scene))?;
            (axis.along.dot(&back) >= POST_COS).then_some(strut)
        };
        wants.iter().map_while(strut).collect()
    }

    /// Whether a strut crosses no other rib.
    fn is_free(&self, strut: &Strut, scene: &Scene) -> bool {
        strut.lines.iter().zip(strut.first..).all(|(line, layer)| {
            let mut lines = self.struts.iter().filter_map(|other| other.line(layer));
            let posts = self.posts.iter().filter(|post| layer <= post.last);
            let mut circles = posts.map(|post| scene.circle(post, layer));
            let reach_mm = (scene.strut_mm + scene.bead_mm) / 2.0;
            lines.all(|other| !line.crosses(other))
                && circles.all(|post| line.distance_mm(post.centre) >= post.radius_mm + reach_mm)
        })
    }

    /// Whether nothing is in the way of a post, from the bed to its top.
    fn has_room(&self, post: &Post, scene: &Scene) -> bool {
        (0..=post.last).all(|layer| {
            let circle = scene.circle(post, layer);
            let reach_mm = circle.radius_mm + scene.bead_mm / 2.0;
            let posts = self.posts.iter().filter(|other| layer <= other.last);
            let apart = |other: Circle| {
                let between_mm =
                    (circle.centre - other.centre).norm() - other.radius_mm - scene.bead_mm / 2.0;
                between_mm >= reach_mm + scene.gap_mm
            };
            let mut struts = self.struts.iter().filter_map(|strut| strut.line(layer));
            scene.has_room(circle, layer)
                && posts.map(|other| scene.circle(other, layer)).all(apart)
                && struts.all(|line| line.distance_mm(circle.centre) >= reach_mm + scene.strut_mm / 2.0)
        })
    }

    /// Layer by layer.
    fn layers(&self, scene: &Scene) -> Vec<Rib> {
        let rib = |layer: usize| Rib {
            posts: self.posts.iter().filter(|p| layer <= p.last).map(|p| scene.circle(p, layer)).collect(),
            struts: self.struts.iter().filter_map(|strut| strut.line(layer)).copied().collect(),
        };
        (0..scene.levels.len()).map(rib).collect()
    }
}

#[cfg(test)]
mod tests;
