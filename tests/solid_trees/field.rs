//! Random vessel trees as analytic fields, and their exact contours.

use lumenfab::geom::{Contour, Point2, Vector2};
use std::collections::BTreeMap;

/// How a branch stands to the trunk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Course {
    /// Leaves the trunk upward.
    Split,
    /// Joins the trunk from below.
    Merge,
    /// Leaves the trunk and comes back.
    Loop,
    /// Begins beside the trunk, inside the stack, and goes on to its top.
    Birth,
    /// Comes from the bottom beside the trunk and ends inside the stack.
    Death,
}

/// A branch, placed relative to the trunk.
#[derive(Debug, Clone)]
pub(crate) struct Branch {
    pub(crate) course: Course,
    /// Where it leaves, joins, begins or ends, as a fraction of the stack's height.
    pub(crate) at: f64,
    /// Sideways travel per mm of height.
    pub(crate) slope: f64,
    /// Radius relative to the trunk's.
    pub(crate) radius: f64,
    /// Departure from its sector's middle direction, in -1..1.
    pub(crate) turn: f64,
}

/// A hole in the trunk: an ellipsoid without lumen.
#[derive(Debug, Clone)]
pub(crate) struct Hole {
    pub(crate) at: f64,
    /// Half height, in plane steps.
    pub(crate) half_steps: f64,
    /// Radius relative to the trunk's.
    pub(crate) radius: f64,
}

/// A random vessel.
#[derive(Debug, Clone)]
pub(crate) struct Tree {
    pub(crate) n_planes: usize,
    pub(crate) step_mm: f64,
    /// Departures of single plane distances from the mean, in -1..1.
    pub(crate) jitter: Vec<f64>,
    pub(crate) trunk_radius_mm: f64,
    pub(crate) wobble_mm: [f64; 2],
    pub(crate) oval: f64,
    pub(crate) blend_mm: f64,
    pub(crate) direction_rad: f64,
    pub(crate) branches: Vec<Branch>,
    pub(crate) hole: Option<Hole>,
}

/// Radius, centre and presence of a tube at a height.
struct Disk {
    centre: Point2,
    radius: f64,
    /// 0 in the body, 1 at the tip of a dome.
    depth: f64,
}

impl Tree {
    pub(crate) fn height_mm(&self) -> f64 {
        self.step_mm * (self.n_planes - 1) as f64
    }

    /// Heights of the planes, ascending.
    pub(crate) fn plane_z_mm(&self) -> Vec<f64> {
        let inner = |k: usize| (k as f64 + 0.3 * self.jitter[k % self.jitter.len()]) * self.step_mm;
        (0..self.n_planes).map(|k| if k == 0 { 0.0 } else { inner(k) }).collect()
    }

    fn axis(&self, z: f64) -> Point2 {
        let phase = std::f64::consts::TAU * z / 45.0;
        Point2::new(self.wobble_mm[0] * phase.sin(), self.wobble_mm[1] * (0.8 * phase).cos())
    }

    /// A sector for every branch, so that branches do not meet each other.
    fn direction(&self, i: usize) -> Vector2 {
        let sector = std::f64::consts::TAU / self.branches.len() as f64;
        let angle = self.direction_rad + sector * (i as f64 + 0.15 * self.branches[i].turn);
        Vector2::new(angle.cos(), angle.sin())
    }

    fn disk(&self, i: usize, z: f64) -> Disk {
        let b = &self.branches[i];
        let z_event = b.at * self.height_mm();
        let radius = b.radius * self.trunk_radius_mm;
        // Rises smoothly from 0 to a straight line of the slope, and levels off far out.
        let travel = |d: f64| {
            let run = 0.5 * (d + d.hypot(4.0));
            let most = 4.0 * self.trunk_radius_mm;
            most * (1.0 - (-b.slope * run / most).exp())
        };
        let beside = self.trunk_radius_mm + radius + 2.0 * self.blend_mm + 1.0;
        let (offset, depth) = match b.course {
            Course::Split => (travel(z - z_event), 0.0),
            Course::Merge => (travel(z_event - z), 0.0),
            Course::Loop => {
                let half = 4.0 * self.step_mm + 2.0 * self.trunk_radius_mm / b.slope;
                let reach = 1.2 * (self.trunk_radius_mm + radius) + 2.0 * self.blend_mm;
                (reach * (-((z - z_event) / half).powi(2)).exp(), 0.0)
            }
            Course::Birth => (beside, ((z_event + 1.5 * radius - z) / (1.5 * radius)).max(0.0).powi(3)),
            Course::Death => (beside, ((z - z_event + 1.5 * radius) / (1.5 * radius)).max(0.0).powi(3)),
        };
        Disk { centre: self.axis(z) + self.direction(i) * offset, radius, depth }
    }

    /// Negative inside, about 1 per mm.
    pub(crate) fn value(&self, p: Point2, z: f64) -> f64 {
        let trunk = p - self.axis(z);
        let angle = trunk.y.atan2(trunk.x);
        let radius = self.trunk_radius_mm * (1.0 + self.oval * (2.0 * angle + 0.03 * z).cos());
        let mut value = trunk.norm() - radius;
        for i in 0..self.branches.len() {
            let disk = self.disk(i, z);
            let rho = (p - disk.centre).norm();
            let field = rho.hypot(disk.radius * disk.depth.sqrt()) - disk.radius;
            value = smooth_min(value, field, self.blend_mm);
        }
        if let Some(hole) = &self.hole {
            let up = (z - hole.at * self.height_mm()) / (hole.half_steps * self.step_mm);
            let radius = hole.radius * self.trunk_radius_mm;
            let field = trunk.norm().hypot(radius * up) - radius;
            value = value.max(-field);
        }
        value
    }

    fn gradient(&self, p: Point2, z: f64) -> Vector2 {
        let h = 1e-5;
        let along = |d: Vector2| (self.value(p + d, z) - self.value(p - d, z)) / (2.0 * h);
        Vector2::new(along(Vector2::new(h, 0.0)), along(Vector2::new(0.0, h)))
    }

    /// The exact contours at a height, material to the left: from a finer grid and with more points where walls are so
    /// close together that the polygons would cross, or that points were moved onto the wall opposite.
    pub(crate) fn contours(&self, z: f64) -> Vec<Contour> {
        let finer =
            [(14.0, 128), (42.0, 256), (84.0, 512)].map(|(steps, n)| move || self.traced(z, steps, n));
        let mut found = Vec::new();
        for traced in finer {
            found = traced();
            if !cross(&found) && found.iter().all(|c| self.keeps_to_its_wall(c, z)) {
                break;
            }
        }
        found
    }

    /// Whether the field falls to the left of a contour everywhere: on the wall opposite it falls to the right.
    fn keeps_to_its_wall(&self, contour: &Contour, z: f64) -> bool {
        let (points, n) = (&contour.points, contour.len());
        (0..n).all(|k| {
            let along = points[(k + 1) % n] - points[(k + n - 1) % n];
            along.perp(&self.gradient(points[k], z)) < 0.0
        })
    }

    /// Contours of `n_points` each, from a grid of so many steps to the trunk's radius.
    fn traced(&self, z: f64, steps: f64, n_points: usize) -> Vec<Contour> {
        let reach = 7.0 * self.trunk_radius_mm + 4.0;
        let step = self.trunk_radius_mm / steps;
        #[expect(clippy::cast_possible_truncation, reason = "some hundred steps")]
        let n = (2.0 * reach / step).ceil() as i32;
        let origin = self.axis(z) - Vector2::repeat(reach);
        let node = |i: i32, j: i32| origin + Vector2::new(f64::from(i), f64::from(j)) * step;
        let values: Vec<f64> = (0..=n)
            .flat_map(|j| (0..=n).map(move |i| (i, j)))
            .map(|(i, j)| self.value(node(i, j), z))
            .collect();
        let at = |i: i32, j: i32| values[(j * (n + 1) + i) as usize];
        // Each cell is cut into two triangles, so that no case is ambiguous. An edge is named by its two nodes.
        let mut next: BTreeMap<[i32; 4], [i32; 4]> = BTreeMap::new();
        for j in 0..n {
            for i in 0..n {
                let c = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
                for t in [[c[0], c[1], c[2]], [c[0], c[2], c[3]]] {
                    let inside = t.map(|(i, j)| at(i, j) < 0.0);
                    let edge = |k: usize| {
                        let (a, b) = (t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3]));
                        [a.0, a.1, b.0, b.1]
                    };
                    let leaves = (0..3).find(|&k| inside[k] && !inside[(k + 1) % 3]);
                    let enters = (0..3).find(|&k| !inside[k] && inside[(k + 1) % 3]);
                    if let (Some(l), Some(e)) = (leaves, enters) {
                        next.insert(edge(l), edge(e));
                    }
                }
            }
        }
        let crossing = |e: [i32; 4]| {
            let (a, b) = (at(e[0], e[1]), at(e[2], e[3]));
            let (p, q) = (node(e[0], e[1]), node(e[2], e[3]));
            p + (q - p) * (a / (a - b))
        };
        let mut found = Vec::new();
        while let Some((&first, _)) = next.first_key_value() {
            let mut points = Vec::new();
            let mut edge = first;
            while let Some(following) = next.remove(&edge) {
                points.push(self.snap(crossing(edge), z));
                edge = following;
            }
            // Even points: neighbours of a triangulated grid may all but coincide.
            let even = Contour::new(points).resampled(n_points);
            found.push(Contour::new(even.points.into_iter().map(|p| self.snap(p, z)).collect()));
        }
        // Less than a segmentation would keep.
        found.retain(|c| c.signed_area_mm2().abs() > 0.05 * self.trunk_radius_mm * self.trunk_radius_mm);
        found
    }

    fn snap(&self, start: Point2, z: f64) -> Point2 {
        let mut p = start;
        for _ in 0..8 {
            let (value, slope) = (self.value(p, z), self.gradient(p, z));
            let step = slope * (value / slope.norm_squared().max(1e-9));
            p -= step * (0.05 / step.norm().max(0.05));
        }
        p
    }
}

/// Whether any two edges of the contours cross, neighbours left out.
fn cross(contours: &[Contour]) -> bool {
    let edges: Vec<(Point2, Point2)> = contours.iter().flat_map(Contour::edges).collect();
    let side = |(a, b): (Point2, Point2), p: Point2| (b - a).perp(&(p - a)) > 0.0;
    let meets = |e: (Point2, Point2), f: (Point2, Point2)| {
        side(e, f.0) != side(e, f.1) && side(f, e.0) != side(f, e.1)
    };
    let joins = |e: (Point2, Point2), f: (Point2, Point2)| e.0 == f.1 || e.1 == f.0;
    let crosses =
        |(k, e): (usize, &(Point2, Point2))| edges[k + 1..].iter().any(|f| !joins(*e, *f) && meets(*e, *f));
    edges.iter().enumerate().any(crosses)
}

fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0);
    a.min(b) - h * h / (4.0 * k)
}
