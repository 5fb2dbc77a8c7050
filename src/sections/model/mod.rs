//! The boundary as the most likely cause of the image: analysis by synthesis.
//!
//! Model of the image: on every plane the grey value is the mean over the slab of what lumen, wall and tissue cover of
//! each pixel, blurred by a Gaussian, plus noise. The contours between the planes, which the slab averages, come from
//! the neighbouring planes. So the displacement of curved edges by blur, of slanted and bending vessels by the slab,
//! and of edges close to another edge need no corrections: they are part of what is compared with the image.
//!
//! Method: Gauss-Newton steps on the likelihood. A displacement of the boundary by d changes the image by the contrast
//! times a Gaussian around the place, so the likelihood's slope is the residual image, blurred once more, at
//! the contour ([`render`]); its curvature is a Gaussian along the contour, simple to divide by in the waves around it.
//! Every wave so comes with the variance of its noise, by which it is smoothed: along the vessel ([`smoother`]), then
//! around the contour towards the falling spectrum of smooth shapes. Levels, blur and wall thickness are fitted along
//! with it ([`levels`]).
//!
//! Accuracy: near the bound of Cramér and Rao. With contrast C, white noise of density S (variance times pixel area)
//! and blur s, each of the waves around a contour of length L is known to a variance of 2 s sqrt(pi) S / (C² L);
//! without smoothing along z the seven waves of a slightly oval vessel of 3 mm radius so leave
//! 0.03 mm at 25 HU of noise, 240 HU of contrast, 0.2 mm pixels and 0.35 mm blur. The smoothing halves it.
//!
//! What it does not do: contours that no centre sees whole stay as they are.

pub(super) mod harmonics;
pub(super) mod levels;
mod plane;
mod render;
mod ring;
mod smoother;

use crate::ct::Volume;
use crate::geom::{Bounds2, Contour, Point2};
use crate::progress::{Cancelled, Task};
use harmonics::Circle;
use levels::Equations;
pub(super) use levels::Levels;
use plane::{Plane, align_centres};
use rayon::prelude::*;
pub(super) use render::Optics;
use render::{Lattice, Slab};
use ring::{At, Course, Outline, Ring};
use smoother::Channel;
use std::f64::consts::PI;

/// Gauss-Newton steps; more of them move the mean error by less than a thousandth of it.
const N_STEPS: usize = 4;
/// Most waves around a contour.
const MOST_WAVES: usize = 40;
/// Waves whose blur leaves less than this of them are not sharpened further.
const LEAST_RESPONSE: f64 = 0.15;
/// The boundary lies within this many pixels, or standard deviations of the blur, of where it was first.
const LIMIT_PIXELS: f64 = 3.0;
const LIMIT_BLURS: f64 = 3.0;
/// A residual of more than this many standard deviations is something else than noise.
const OUTLIER: f64 = 4.0;
/// Levels are pooled over this many planes below and above, and over contours whose radii differ by less than a factor.
const POOLED_PLANES: usize = 4;
const LIKE_SIZE: f64 = 1.5;
/// The power of a smooth shape's waves falls with this power of their number: that of a random third derivative, as
/// along the vessel.
const FALL: i32 = 6;

/// Waves around the longest contour are followed up to this many blurs a radian: the blur leaves exp(-1.6²/2), 28 %, of the last;
/// and six in any case, which an oval with a dent has.
const WAVE_BLURS: f64 = 1.6;
const LEAST_WAVES: f64 = 6.0;
/// Four points around a contour for each so many blurs of the longest: closer ones would measure the same; within 64 and 512.
const POINT_BLURS: f64 = 2.4;
const QUARTER_POINTS: [f64; 2] = [16.0, 128.0];
/// Blur and wall may become this many times those that the edges told at first: beyond, something else is fitted.
const OPTICS_LIMITS: [f64; 2] = [0.4, 2.5];
/// A contour is moved along its rays; where these meet it at less than this cosine, a step would throw it too far.
const LEAST_FACING: f64 = 0.3;
/// Most of a step, standard deviations of the blur: farther the slope of the likelihood tells nothing.
const STEP_BLURS: f64 = 2.0;
/// A body with less than this share of the stack's contrast has levels that are not believed; the stack's are taken.
const LEAST_CONTRAST: f64 = 0.3;
/// What is drawn counts as known to within a centimetre where contours are smoothed along the vessel: it leads on, and pulls nothing.
const UNMEASURED_MM2: f64 = 100.0;
/// From a median of absolute deviations to a standard deviation.
const DEVIATION: f64 = 1.4826;

/// What a contour is that the fit starts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Footing {
    /// Made where the image shows none: it stays.
    Made,
    /// Drawn by the operator: it stays, and its plane's image has no say.
    Drawn,
    /// Where the edge in the image is, as far as it shows one: its details are the image's.
    Measured,
    /// Cut, or not moved to the edge: what it has of details are none.
    Rough,
}

impl Footing {
    /// Whether the image moves it.
    pub(super) const fn is_image(self) -> bool {
        matches!(self, Self::Measured | Self::Rough)
    }
}

/// What the fit starts from on one plane.
#[derive(Debug, Clone)]
pub(super) struct Start {
    /// Index in the volume.
    pub(super) k: usize,
    pub(super) z_mm: f64,
    pub(super) contours: Vec<Contour>,
    /// What each contour is.
    pub(super) footing: Vec<Footing>,
    pub(super) levels: Levels,
}

/// The scan, and what is the same for all planes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scan<'a> {
    pub(super) volume: &'a Volume,
    /// +1 for a bright lumen, -1 for a dark one.
    pub(super) sign: f64,
    pub(super) levels: Levels,
    pub(super) optics: Optics,
}

/// The boundary, and how well it explains the image.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    /// Contours of every plane as dense points, in the order of the start.
    pub(super) contours: Vec<Vec<Contour>>,
    /// Image less model, per plane.
    residuals: Vec<Residual>,
    /// Noise variance times pixel area, HU² mm².
    noise_density: f64,
}

#[derive(Debug, Clone)]
struct Residual {
    values: Vec<f64>,
    is_edge: Vec<bool>,
    place: Lattice,
}

impl Fit {
    /// Twice the logarithm of how much likelier plane `n` is, within the box, under this fit than under the other: white noise.
    pub(super) fn evidence_over(&self, other: &Self, n: usize, within: &Bounds2) -> f64 {
        let (mine, theirs) = (&self.residuals[n], &other.residuals[n]);
        if mine.values.len() != theirs.values.len() {
            return 0.0;
        }
        let density = self.noise_density.min(other.noise_density).max(f64::MIN_POSITIVE);
        let worth = |p: usize| theirs.values[p].powi(2) - mine.values[p].powi(2);
        let counts =
            |p: &usize| (mine.is_edge[*p] || theirs.is_edge[*p]) && within.contains(mine.place.centre(*p));
        let sum: f64 = (0..mine.values.len()).filter(counts).map(worth).sum();
        sum * mine.place.pixel_mm2() / density
    }
}

/// What one step finds on a plane.
struct Finding {
    /// Displacement of every ring's points along their rays, mm.
    moves: Vec<Option<Vec<f64>>>,
    equations: Vec<Equations>,
    /// Residuals and blurred residuals at the edge, absolute.
    rough: Vec<f64>,
    smooth: Vec<f64>,
}

struct State<'a> {
    scan: Scan<'a>,
    limits: [Optics; 2],
    circle: Circle,
    n_waves: usize,
    planes: Vec<Plane>,
    /// Standard deviation of residuals and of blurred residuals, HU.
    noise: [f64; 2],
}

/// The most likely contours of every plane as dense points, in the order of the start. `views` are the contours around
/// which the image is looked at.
///
/// # Errors
/// [`Cancelled`] on request.
pub(super) fn contours(
    scan: Scan<'_>,
    starts: &[Start],
    views: &[Vec<Contour>],
    task: &Task<'_>,
) -> Result<Vec<Vec<Contour>>, Cancelled> {
    State::fitted(scan, starts, views, task).map(|state| state.contours())
}

/// The same, with how well they explain the image.
///
/// # Errors
/// [`Cancelled`] on request.
pub(super) fn weighed(
    scan: Scan<'_>,
    starts: &[Start],
    views: &[Vec<Contour>],
    task: &Task<'_>,
) -> Result<Fit, Cancelled> {
    let state = State::fitted(scan, starts, views, task)?;
    let residuals = state.for_planes(|plane, courses| state.finding(plane, courses).1);
    Ok(Fit { contours: state.contours(), residuals, noise_density: state.noise_density() })
}

impl<'a> State<'a> {
    fn fitted(
        scan: Scan<'a>,
        starts: &[Start],
        views: &[Vec<Contour>],
        task: &Task<'_>,
    ) -> Result<Self, Cancelled> {
        let mut state = Self::new(scan, starts, views);
        for step in 0..N_STEPS {
            task.check()?;
            let findings = state.findings();
            state.learn(&findings, step > 0);
            state.advance(&findings);
        }
        Ok(state)
    }

    fn contours(&self) -> Vec<Vec<Contour>> {
        let dense = |p: &Plane| p.outlines.iter().map(|o| self.contour(o)).collect();
        self.planes.iter().map(dense).collect()
    }

    fn new(scan: Scan<'a>, starts: &[Start], views: &[Vec<Contour>]) -> Self {
        let longest = starts.iter().flat_map(|s| &s.contours).map(Contour::perimeter_mm).fold(0.0, f64::max);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let whole = |v: f64, low: f64, high: f64| v.ceil().clamp(low, high) as usize;
        let blur_mm = scan.optics.blur_mm;
        let n_waves = whole(WAVE_BLURS * longest / (2.0 * PI * blur_mm), LEAST_WAVES, MOST_WAVES as f64);
        let [least, most] = QUARTER_POINTS;
        let circle = Circle::new(4 * whole(longest / (POINT_BLURS * blur_mm), least, most).max(n_waves));
        let optics = scan.optics;
        let limits =
            OPTICS_LIMITS.map(|f| Optics { blur_mm: f * optics.blur_mm, wall_mm: f * optics.wall_mm });
        let plane = |(start, view): (&Start, &Vec<Contour>)| Plane::new(start, view, &scan, &circle);
        let mut planes: Vec<Plane> = starts.iter().zip(views).map(plane).collect();
        align_centres(&mut planes, &circle);
        Self { scan, limits, circle, n_waves, planes, noise: [f64::INFINITY, 0.0] }
    }

    fn contour(&self, outline: &Outline) -> Contour {
        match outline {
            Outline::Fixed(contour) | Outline::Held(_, contour) => contour.clone(),
            Outline::Free(ring) => {
                let contour = Contour::new(ring.points(&self.circle));
                if ring.is_hole { contour.reversed() } else { contour }
            }
        }
    }

    /// Square of the noise's own blur, mm², from how much more blur takes away: neighbouring pixels of a CT are alike.
    fn grain_mm2(&self) -> f64 {
        let [rough, smooth] = self.noise.map(|n| n * n);
        let share = if rough.is_finite() { (smooth / (rough - smooth).max(smooth)).min(1.0) } else { 0.0 };
        self.scan.optics.blur_mm.powi(2) * share
    }

    /// Noise power at long waves, HU² mm².
    fn noise_density(&self) -> f64 {
        4.0 * PI * (self.scan.optics.blur_mm.powi(2) + self.grain_mm2()) * self.noise[1].powi(2)
    }

    /// The course of every ring, by plane and contour.
    fn courses(&self, runs: &[Vec<At>]) -> Vec<Vec<Option<Course>>> {
        let mut courses: Vec<Vec<Option<Course>>> =
            self.planes.iter().map(|p| vec![None; p.outlines.len()]).collect();
        for run in runs {
            let points: Vec<Vec<Point2>> =
                run.iter().filter_map(|&at| Some(self.ring(at)?.points(&self.circle))).collect();
            for (n, &(k, i)) in run.iter().enumerate() {
                let dz = |m: usize| self.planes[run[m].0].z_mm - self.planes[k].z_mm;
                let below = n.checked_sub(1).map(|m| (dz(m), points[m].as_slice()));
                let above = (n + 1 < run.len()).then(|| (dz(n + 1), points[n + 1].as_slice()));
                courses[k][i] = Course::of(&points[n], below, above);
            }
        }
        courses
    }

    fn ring(&self, (k, i): At) -> Option<&Ring> {
        self.planes[k].outlines[i].ring()
    }

    fn findings(&self) -> Vec<Finding> {
        self.for_planes(|plane, courses| self.finding(plane, courses).0)
    }

    fn for_planes<T: Send>(&self, of: impl Fn(&Plane, &[Option<Course>]) -> T + Sync) -> Vec<T> {
        let courses = self.courses(&ring::runs(&self.outlines(), &self.circle));
        self.planes.par_iter().zip(&courses).map(|(plane, courses)| of(plane, courses)).collect()
    }

    fn outlines(&self) -> Vec<Vec<Outline>> {
        self.planes.iter().map(|p| p.outlines.clone()).collect()
    }

    /// What this step finds on a plane, and what it leaves unexplained there.
    fn finding(&self, plane: &Plane, courses: &[Option<Course>]) -> (Finding, Residual) {
        // Between the parts of an interrupted vessel there is nothing to be seen.
        if plane.is_drawn || plane.bodies.is_empty() {
            return plane.unseen();
        }
        let (view, optics) = (&plane.view, self.scan.optics);
        let slab_mm = self.scan.volume.slab_thickness_mm;
        let slab = |&i: &usize| Slab::of(&plane.outlines[i], courses[i].as_ref(), slab_mm, &self.circle);
        let bodies: Vec<Vec<Slab>> = plane.bodies.iter().map(|b| b.iter().map(slab).collect()).collect();
        let shares = view.render(&bodies, optics);
        let owners = shares.owners();
        let image = levels::image(&shares, &owners, &plane.levels);
        let most = OUTLIER * self.noise[0];
        let residual = |(&v, m): (&f32, &f64)| match f64::from(v) {
            v if v.is_finite() => (v - m).clamp(-most, most),
            _ => 0.0,
        };
        let residual: Vec<f64> = view.values.iter().zip(&image).map(residual).collect();
        let blurred = view.blurred(&residual, optics.blur_mm);
        let is_edge: Vec<bool> = shares.total().into_iter().map(levels::is_edge).collect();
        let weight = view.pixel_mm2() / self.noise_density().max(1e-9);
        let weight = if self.noise[1] > 0.0 { weight } else { 0.0 };
        let at_edge = |image: &[f64]| {
            let kept = image.iter().zip(&is_edge).filter(|(_, e)| **e);
            kept.step_by(3).map(|(v, _)| v.abs()).collect()
        };
        let finding = Finding {
            moves: (0..plane.outlines.len())
                .map(|i| self.moves(plane, i, courses[i].as_ref(), &blurred))
                .collect(),
            equations: levels::equations(
                levels::Shown { view, shares: &shares, owners: &owners, levels: &plane.levels },
                &residual,
                optics,
                weight,
            ),
            rough: at_edge(&residual),
            smooth: at_edge(&blurred),
        };
        (finding, Residual { place: view.place, values: residual, is_edge })
    }

    /// By how much each point of a ring has to move along its ray, read from the blurred residual.
    fn moves(&self, plane: &Plane, i: usize, course: Option<&Course>, blurred: &[f64]) -> Option<Vec<f64>> {
        let ring = plane.outlines[i].free()?;
        let body = plane.bodies.iter().position(|b| b.contains(&i))?;
        let contrast = plane.levels[body].contrast();
        let points = ring.points(&self.circle);
        let outward = if ring.is_hole { -1.0 } else { 1.0 };
        let others = self.neighbours(plane, body);
        let normals = super::curve::normals(&points);
        let (blur, slab_mm) = (self.scan.optics.blur_mm, self.scan.volume.slab_thickness_mm);
        let of = |j: usize| {
            let smear = course.map_or(0.0, |c| c.slope[j].dot(&normals[j]) * slab_mm);
            let square = 2.0 * blur * blur + plane.view.pixel_blur_mm2() * 2.0 + smear * smear / 12.0;
            let shift = plane.view.at(blurred, points[j]) * (2.0 * PI * square).sqrt() / contrast;
            let [cos, sin] = self.circle.at(j);
            let facing = (normals[j].x * cos + normals[j].y * sin).max(LEAST_FACING);
            let crowded = 1.0 + crowding(points[j], &others, blur);
            outward * shift.clamp(-STEP_BLURS * blur, STEP_BLURS * blur) / (facing * crowded)
        };
        Some((0..points.len()).map(of).collect())
    }

    /// The points of a plane's other bodies.
    fn neighbours(&self, plane: &Plane, body: usize) -> Vec<Point2> {
        let others = plane.bodies.iter().enumerate().filter(|(b, _)| *b != body).flat_map(|(_, rings)| rings);
        others.filter_map(|&i| plane.outlines[i].ring()).flat_map(|r| r.points(&self.circle)).collect()
    }

    /// Noise, levels, blur and wall from the findings.
    fn learn(&mut self, findings: &[Finding], move_levels: bool) {
        let pooled = |of: fn(&Finding) -> &Vec<f64>| {
            let all = findings.iter().flat_map(|f| of(f).iter().copied()).collect();
            DEVIATION * super::fit::quantile(all, 0.5).unwrap_or(0.0)
        };
        self.noise = [pooled(|f| &f.rough), pooled(|f| &f.smooth)];
        if !move_levels {
            return;
        }
        let mut whole = Equations::none();
        findings.iter().flat_map(|f| &f.equations).for_each(|e| whole.add(e));
        let (stack, optics) = whole.stack(&self.scan.levels, self.scan.optics, &self.limits);
        let pools = self.pools(findings);
        let solved = |spread: [f64; 3]| -> Vec<Vec<(Levels, [f64; 3])>> {
            let of = |(p, pools): (&Plane, &Vec<Equations>)| {
                p.levels.iter().zip(pools).map(|(l, e)| e.levels(l, &stack, spread)).collect()
            };
            self.planes.iter().zip(&pools).map(of).collect()
        };
        let free: Vec<(Levels, [f64; 3])> =
            solved(levels::first_spread(&stack)).into_iter().flatten().collect();
        let levels = solved(levels::spread(&free, &stack));
        for (plane, found) in self.planes.iter_mut().zip(levels) {
            let sound = |(l, _): (Levels, [f64; 3])| {
                if l.contrast() > LEAST_CONTRAST * stack.contrast() { l } else { stack }
            };
            let levels: Vec<Levels> = found.into_iter().map(sound).collect();
            let lift = |(new, old): (&Levels, &Levels)| new.half() - old.half();
            plane.lifted = levels.iter().zip(&plane.levels).map(lift).collect();
            plane.levels = levels;
        }
        (self.scan.levels, self.scan.optics) = (stack, optics);
    }

    /// The equations of every body, pooled over bodies of like size in the planes around.
    fn pools(&self, findings: &[Finding]) -> Vec<Vec<Equations>> {
        let radii: Vec<Vec<f64>> = self.planes.iter().map(Plane::body_radii_mm).collect();
        let pool = |k: usize, radius_mm: f64| {
            let mut sum = Equations::none();
            for n in k.saturating_sub(POOLED_PLANES)..(k + POOLED_PLANES + 1).min(radii.len()) {
                for (radius, equations) in radii[n].iter().zip(&findings[n].equations) {
                    if *radius < LIKE_SIZE * radius_mm && radius_mm < LIKE_SIZE * radius {
                        sum.add(equations);
                    }
                }
            }
            sum
        };
        (0..radii.len()).map(|k| radii[k].iter().map(|&r| pool(k, r)).collect()).collect()
    }

    /// Moves all rings.
    fn advance(&mut self, findings: &[Finding]) {
        let runs = ring::runs(&self.outlines(), &self.circle);
        let moved: Vec<Vec<(At, Vec<f64>)>> = runs.par_iter().map(|run| self.moved(run, findings)).collect();
        for ((k, i), radii) in moved.into_iter().flatten() {
            let plane = &mut self.planes[k];
            let [w, limit] = [plane.view.pixel_mm2().sqrt(), self.scan.optics.blur_mm];
            let limit = (LIMIT_PIXELS * w).max(LIMIT_BLURS * limit);
            if let (Outline::Free(ring), Some(first)) = (&mut plane.outlines[i], &plane.first[i]) {
                let limit = limit.min(0.5 * ring.mean_radius_mm());
                let within = |(r, f): (f64, &f64)| r.clamp(f - limit, f + limit).max(0.1 * f);
                let radii: Vec<f64> = radii.into_iter().zip(first).map(within).collect();
                // Where the limit has cut, it has left a corner.
                ring.radii = self.circle.values(&self.circle.waves(&radii, self.n_waves));
            }
        }
    }

    /// The radii of a run's rings after one step and its smoothing.
    fn moved(&self, run: &[At], findings: &[Finding]) -> Vec<(At, Vec<f64>)> {
        let mut waves: Vec<Vec<[f64; 2]>> = Vec::with_capacity(run.len());
        let mut noise: Vec<Vec<[f64; 2]>> = Vec::with_capacity(run.len());
        for &(k, i) in run {
            let plane = &self.planes[k];
            if let Outline::Held(ring, _) = &plane.outlines[i] {
                waves.push(self.circle.waves(&ring.radii, self.n_waves));
                noise.push(vec![[UNMEASURED_MM2; 2]; self.n_waves + 1]);
                continue;
            }
            let (Some(ring), Some(moves)) = (self.ring((k, i)), &findings[k].moves[i]) else {
                return Vec::new();
            };
            let Some(body) = plane.bodies.iter().position(|b| b.contains(&i)) else { return Vec::new() };
            let (w, v) = self.measured(ring, moves, plane.levels[body].contrast(), plane.lifted[body]);
            waves.push(w);
            noise.push(v);
        }
        self.smooth_along(run, &mut waves, &mut noise);
        let shrunk = waves.iter_mut().zip(&noise).map(|(w, v)| {
            shrink(w, v);
            self.circle.values(w)
        });
        run.iter().copied().zip(shrunk).collect()
    }

    /// Waves of the radii as the image asks for them, and the variance of their noise.
    fn measured(
        &self,
        ring: &Ring,
        moves: &[f64],
        contrast: f64,
        lifted: f64,
    ) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
        let mut waves = self.circle.waves(&ring.radii, self.n_waves);
        let mut moves = self.circle.waves(moves, self.n_waves);
        let (length, blur) = (2.0 * PI * ring.mean_radius_mm(), self.scan.optics.blur_mm);
        // The moves were read from the image under the levels of before.
        let outward = if ring.is_hole { -1.0 } else { 1.0 };
        moves[0][0] -= outward * lifted * 2.0 * PI.sqrt() * blur / contrast;
        let softened = blur * blur / (blur * blur + self.grain_mm2()).sqrt();
        let per_wave = 2.0 * PI.sqrt() * softened * self.noise_density() / (contrast * contrast * length);
        let mut noise = Vec::with_capacity(waves.len());
        for (m, (wave, step)) in waves.iter_mut().zip(moves).enumerate() {
            let response = (-(2.0 * PI * m as f64 / length * blur).powi(2)).exp().max(1e-3);
            let sharpened = response.max(LEAST_RESPONSE);
            *wave = [wave[0] + step[0] / sharpened, wave[1] + step[1] / sharpened];
            let variance = (per_wave * if m == 0 { 1.0 } else { 2.0 } / response).max(1e-18);
            noise.push([variance; 2]);
        }
        (waves, noise)
    }

    /// Smooths the waves of a run along z; the first wave is that of the place.
    fn smooth_along(&self, run: &[At], waves: &mut [Vec<[f64; 2]>], noise: &mut [Vec<[f64; 2]>]) {
        let z_mm: Vec<f64> = run.iter().map(|&(k, _)| self.planes[k].z_mm).collect();
        let centres: Vec<[f64; 2]> =
            run.iter().map(|&at| self.ring(at).map_or([0.0; 2], |r| [r.centre.x, r.centre.y])).collect();
        let at = |m: usize, c: usize, n: usize| if m == 1 { centres[n][c] } else { 0.0 };
        let places: Vec<[usize; 2]> =
            (0..=self.n_waves).flat_map(|m| [[m, 0], [m, 1]]).filter(|p| *p != [0, 1]).collect();
        let channel = |&[m, c]: &[usize; 2]| Channel {
            values: (0..run.len()).map(|n| waves[n][m][c] + at(m, c, n)).collect(),
            noise: noise.iter().map(|v| v[m][c]).collect(),
            family: m,
        };
        let mut channels: Vec<Channel> = places.iter().map(channel).collect();
        smoother::smooth(&z_mm, &mut channels);
        for (channel, [m, c]) in channels.iter().zip(places) {
            for n in 0..run.len() {
                waves[n][m][c] = channel.values[n] - at(m, c, n);
                noise[n][m][c] = channel.noise[n];
            }
        }
    }
}

/// How much of the residual at a point another edge may have made: what is left of a Gaussian over both blurs.
fn crowding(p: Point2, others: &[Point2], blur_mm: f64) -> f64 {
    let square = others.iter().map(|o| (o - p).norm_squared()).fold(f64::INFINITY, f64::min);
    (-square / (4.0 * blur_mm * blur_mm)).exp()
}

/// Draws the waves of a shape towards what smooth shapes have: each by the share of its power that is noise. The height
/// of the shape's falling spectrum is the likeliest (Whittle).
fn shrink(waves: &mut [[f64; 2]], noise: &[[f64; 2]]) {
    let modes: Vec<(f64, f64, f64)> = (2..waves.len())
        .flat_map(|m| [0, 1].map(|c| ((m as f64).powi(-FALL), waves[m][c].powi(2), noise[m][c])))
        .collect();
    let Some(least) = modes.iter().map(|(fall, _, v)| v / fall).reduce(f64::min) else { return };
    let cost = |height: f64| {
        let term = |&(fall, power, v): &(f64, f64, f64)| {
            let expected = height * fall + v;
            expected.ln() + power / expected
        };
        modes.iter().map(term).sum::<f64>()
    };
    let heights = (0..90).map(|i| 0.01 * least * 1.3_f64.powi(i));
    let best = heights.map(|h| (h, cost(h))).min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0.0, |b| b.0);
    for (m, wave) in waves.iter_mut().enumerate().skip(2) {
        let power = best * (m as f64).powi(-FALL);
        (0..2).for_each(|c| wave[c] *= power / (power + noise[m][c]));
    }
}
