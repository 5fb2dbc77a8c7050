//! A planned job to the text of a G-code file in the profile's dialect.
//!
//! Extrusion is relative (`M83`) in steps of 10 nm of filament; what a step is rounded by is carried to
//! the next, so the sum is exact. Coordinates are rounded to 1 um. Each layer begins with `;LAYER:`,
//! `;Z:` (top of the layer above the bed), `;HEIGHT:` and, where its middle is a CT plane, `;CT_PLANE:`;
//! each change of what is printed with `;TYPE:`. The header names the profile, the placement and a BLAKE3
//! hash of all settings; no date and nothing of the patient. Before the first layer the machine is given the profile's
//! limits; the object is labelled in each layer, so that it can be left out; the fan follows the layer's time.
//!
//! Before a travel through air the filament is drawn back, where the profile says so while the nozzle goes back along its bead
//! and forth again (a wipe): it leaves from where the travel was planned to.
//!
//! A layer that is done too soon even at the slowest speed is waited for, as the module `cool` says: the filament drawn back, the
//! nozzle lifted and beside all that is printed, where there is room; then it comes back to where it was, and goes on from there.
//!
//! How long the job takes is not known here: [`timed`](super::timed) adds it.

use super::path::{self, Arc, Pace, Piece};
use super::{Thumbnail, cool, label, limits};
use crate::geom::{Bounds2, Point2, Point3};
use crate::profile::Profile;
use crate::toolpath::{Bead, BeadKind, BeadModel, BeadPoint, LayerPaths, Toolpaths, Travel};
use crate::units::{micrometres, mm_min_from_mm_s};
use std::f64::consts::FRAC_PI_4;
use std::fmt::Write;

/// What the header says beyond the profile.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Header {
    /// Canonical text of all parameters that led to the job (not of the patient): only its hash is written.
    pub settings: String,
    /// Pictures of the job.
    pub thumbnails: Vec<Thumbnail>,
}

/// The fan is set in steps of this, percent: finer ones are noise.
const FAN_STEP_PERCENT: f64 = 5.0;

/// Coordinates are written in steps of 1 um.
const COORDINATE_DECIMALS: usize = 3;
/// Filament is written in steps of 10 nm: a hundredth of what a gear of 400 steps/mm can do.
const FILAMENT_DECIMALS: usize = 5;
/// The start script may leave the nozzle on the bed: above this the way to the first bead is clear of clips and ooze, mm.
const APPROACH_MM: f64 = 5.0;
/// A wipe shorter than this moves nothing away, mm.
const SHORTEST_WIPE_MM: f64 = 0.1;
/// So far above the layer the nozzle goes aside to wait, mm.
const ASIDE_LIFT_MM: f64 = 3.0;

/// The text of the job.
#[must_use]
pub fn write(paths: &Toolpaths, profile: &Profile, header: &Header) -> String {
    let n_points: usize = paths.layers.iter().flat_map(|l| &l.beads).map(|b| b.points.len()).sum();
    let mut job = Job::new(profile, String::with_capacity(40 * n_points + 4096));
    job.header(paths, header);
    profile.start_gcode().iter().for_each(|line| job.line(line));
    // Whatever the script did: the job is written in absolute coordinates and relative filament.
    ["G90", "M83", "M107"].iter().for_each(|line| job.line(line));
    limits::lines(profile).iter().for_each(|line| job.line(line));
    label::defined(profile.firmware.object_labels, paths).iter().for_each(|line| job.line(line));
    let points = paths.layers.iter().flat_map(|l| &l.beads).flat_map(|b| &b.points);
    let printed = Bounds2::of(points.map(|p| p.at));
    for (idx, layer) in paths.layers.iter().enumerate() {
        job.layer(idx, paths.layers.len(), layer);
        // The end script parks the nozzle by itself.
        if let (Some(printed), Some(above)) = (printed, paths.layers.get(idx + 1)) {
            job.wait([layer, above], printed);
        }
        job.label(false);
    }
    job.line(";TYPE:Custom");
    let top_mm = paths.layers.last().map_or(0.0, |l| l.z_mm);
    profile.end_gcode(top_mm).iter().for_each(|line| job.line(line));
    job.text
}

/// The text so far and the state of the machine that reads it.
struct Job<'a> {
    profile: &'a Profile,
    text: String,
    /// In steps of 1 um, where known.
    at: Option<[i64; 2]>,
    z: i64,
    feedrate_mm_min: i64,
    kind: Option<BeadKind>,
    /// Filament that was asked for less what was written, mm.
    owed_mm: f64,
    /// mm of filament per mm³ of bead.
    filament_per_mm3: f64,
    model: BeadModel,
    /// The fan as it is, and as this layer wants it where it lays nothing over air.
    fan_percent: f64,
    layer_fan_percent: f64,
    retracted: bool,
    /// Time of the layer so far, accelerations left out, s.
    elapsed_s: f64,
    /// The last bead's way back from its end, as far as a wipe may go.
    back: Vec<[i64; 2]>,
    is_labelled: bool,
}

impl<'a> Job<'a> {
    fn new(profile: &'a Profile, text: String) -> Self {
        let area_mm2 = FRAC_PI_4 * profile.machine.filament_mm.powi(2);
        Self {
            profile,
            text,
            at: None,
            z: i64::MIN,
            feedrate_mm_min: 0,
            kind: None,
            owed_mm: 0.0,
            filament_per_mm3: profile.filament.flow_percent / 100.0 / area_mm2,
            model: BeadModel::new(profile.print.bead_shape, 0.0),
            fan_percent: 0.0,
            layer_fan_percent: 0.0,
            retracted: false,
            elapsed_s: 0.0,
            back: Vec::new(),
            is_labelled: false,
        }
    }

    fn line(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
    }

    fn header(&mut self, paths: &Toolpaths, header: &Header) {
        let mut hasher = blake3::Hasher::new();
        hasher.update(crate::profile::to_toml(self.profile).as_bytes());
        hasher.update(header.settings.as_bytes());
        let origin = paths.bed_from_stack.apply(Point3::origin());
        let volume: f64 = paths.layers.iter().map(|l| volume_mm3(l, self.profile)).sum();
        let filament_mm = volume * self.filament_per_mm3 + self.profile.primed_filament_mm();
        let area_mm2 = FRAC_PI_4 * self.profile.machine.filament_mm.powi(2);
        let mass_g = filament_mm * area_mm2 * self.profile.filament.density_g_cm3 / 1000.0;
        let n_ct = paths.layers.iter().filter(|l| l.slot.ct_plane.is_some()).count();
        // Another program's model knows neither CT nor stack.
        let (on_ct, shift) = match n_ct {
            0 => (String::new(), "model_shift_mm"),
            n => (format!(", on CT planes {n}"), "bed_from_stack_mm"),
        };
        self.line(&format!("; generated by lumenfab {}", env!("CARGO_PKG_VERSION")));
        for line in [
            format!("; settings blake3:{}", hasher.finalize().to_hex()),
            format!("; profile {}, {}", self.profile.name, self.profile.filament.material),
            format!("; layers {}{on_ct}", paths.layers.len()),
            format!("; {shift} {:.6},{:.6},{:.6}", origin.x, origin.y, origin.z),
            format!("; filament_mm {filament_mm:.1}"),
            format!("; filament_g {mass_g:.2}"),
            format!("; filament used [mm] = {filament_mm:.2}"),
            format!("; filament used [g] = {mass_g:.2}"),
        ] {
            self.line(&line);
        }
        header.thumbnails.iter().flat_map(Thumbnail::lines).for_each(|line| self.line(&line));
        self.line(";TYPE:Custom");
    }

    fn layer(&mut self, idx: usize, n_layers: usize, layer: &LayerPaths) {
        let z = micrometres(layer.z_mm);
        self.model = BeadModel::new(self.profile.print.bead_shape, layer.slot.height_mm);
        self.kind = None;
        self.elapsed_s = 0.0;
        let _infallible = writeln!(self.text, ";LAYER:{idx}");
        self.comment(";Z:", z);
        self.comment(";HEIGHT:", micrometres(layer.slot.height_mm));
        if let Some(plane) = layer.slot.ct_plane {
            let _infallible = writeln!(self.text, ";CT_PLANE:{plane}");
        }
        if idx == 1 {
            self.after_first_layer();
        }
        let moves = self.moves(layer, idx == 0);
        let driven_s: f64 = moves.iter().flatten().map(Piece::time_s).sum();
        let is_last = idx + 1 == n_layers;
        let time_s = cool::layer_time_s(driven_s + travel_s(layer, self.profile), is_last, self.profile);
        self.layer_fan_percent = cool::fan_percent(idx, time_s, self.profile);
        self.fan(self.layer_fan_percent);
        let straight = Travel::default();
        for (i, (bead, moves)) in layer.beads.iter().zip(moves).enumerate() {
            let travel = layer.travels.get(i).unwrap_or(&straight);
            // A column without what it holds up is of no use.
            self.label(bead.kind != BeadKind::SkirtBrim);
            self.travel(bead.points[0].at, travel, z);
            self.bead(bead, moves);
        }
    }

    /// Waits for what a layer lacks of its least time before the one above it, aside where there is room; comes back to where it was,
    /// lifted and drawn back.
    fn wait(&mut self, [layer, above]: [&LayerPaths; 2], printed: Bounds2) {
        let print = &self.profile.print;
        if layer.beads.is_empty() || !cool::is_too_short(self.elapsed_s, print) {
            return;
        }
        self.retract();
        let Some(from) = self.at else { return };
        let bed_mm = self.profile.machine.bed_mm;
        self.lift((self.z + micrometres(ASIDE_LIFT_MM)).min(micrometres(bed_mm[2])).max(self.z));
        let missing_s = |writer: &Self| print.min_layer_time_s - writer.elapsed_s;
        let way_s = |to| distance_mm(from, to) / print.travel_mm_s;
        let around =
            cool::Around { printed, material: &layer.material, lumens: [&layer.lumen, &above.lumen], bed_mm };
        // A way that takes longer than there is to wait is none to go.
        let most_mm = missing_s(self) / 2.0 * print.travel_mm_s;
        let Some(aside) = around.aside(place(from), most_mm).map(steps) else {
            return self.dwell(missing_s(self));
        };
        self.go(aside, None, print.travel_mm_s);
        self.dwell(missing_s(self) - way_s(aside));
        self.go(from, None, print.travel_mm_s);
    }

    /// Stands still.
    fn dwell(&mut self, seconds: f64) {
        let ms = (1e3 * seconds).ceil();
        if ms > 0.0 {
            // All firmwares know milliseconds, not all of them seconds.
            self.line(&format!("G4 P{ms}"));
        }
    }

    /// The moves of a layer's beads, as fast as they are driven.
    fn moves(&self, layer: &LayerPaths, is_first_layer: bool) -> Vec<Vec<Piece>> {
        let slow_down =
            cool::slow_down(layer, self.profile, |bead| speed(bead, self.profile, is_first_layer));
        let least_mm_s = self.profile.print.min_speed_mm_s;
        let of_bead = |bead: &Bead| {
            let pace = Pace { speed_mm_s: speed(bead, self.profile, is_first_layer), slow_down, least_mm_s };
            path::pieces(&bead.points, self.model, pace, self.profile)
        };
        layer.beads.iter().map(of_bead).collect()
    }

    /// Says whether what comes belongs to the object.
    fn label(&mut self, is_object: bool) {
        if self.is_labelled != is_object {
            self.is_labelled = is_object;
            let style = self.profile.firmware.object_labels;
            let line = if is_object { label::begin(style) } else { label::end(style) };
            line.iter().for_each(|line| self.line(line));
        }
    }

    fn fan(&mut self, percent: f64) {
        let percent = (percent / FAN_STEP_PERCENT).round() * FAN_STEP_PERCENT;
        if (percent - self.fan_percent).abs() > FAN_STEP_PERCENT / 2.0 {
            self.fan_percent = percent;
            if percent > 0.0 {
                self.line(&format!("M106 S{}", (percent * 2.55).round()));
            } else {
                self.line("M107");
            }
        }
    }

    fn comment(&mut self, tag: &str, steps: i64) {
        self.text.push_str(tag);
        number(&mut self.text, steps, COORDINATE_DECIMALS);
        self.text.push('\n');
    }

    fn after_first_layer(&mut self) {
        let filament = &self.profile.filament;
        if filament.hotend_c != filament.first_layer_hotend_c {
            self.line(&format!("M104 S{}", filament.hotend_c.0));
        }
        if filament.bed_c != filament.first_layer_bed_c {
            self.line(&format!("M140 S{}", filament.bed_c.0));
        }
    }

    /// Goes to where a bead begins, at the layer's height, retracted where that helps.
    fn travel(&mut self, to: Point2, travel: &Travel, z: i64) {
        let print = &self.profile.print;
        let way: Vec<[i64; 2]> = travel.via.iter().copied().chain([to]).map(steps).collect();
        let length = self.at.map_or(f64::INFINITY, |at| {
            [at].iter().chain(&way).zip(&way).map(|(a, b)| distance_mm(*a, *b)).sum()
        });
        let retract = travel.leaves_material && length >= print.retract_min_travel_mm && self.at.is_some();
        if retract {
            self.retract();
        }
        let hop = match self.at {
            None => micrometres(APPROACH_MM),
            Some(_) if retract || self.retracted => micrometres(print.z_hop_mm),
            Some(_) => 0,
        };
        self.lift((z + hop).min(micrometres(self.profile.machine.bed_mm[2])).max(z));
        for point in way {
            self.go(point, None, print.travel_mm_s);
        }
        self.lift(z);
        self.unretract();
    }

    fn retract(&mut self) {
        let print = &self.profile.print;
        if print.retract_mm > 0.0 && !self.retracted {
            self.retracted = true;
            let wiped_mm = self.wipe();
            if wiped_mm < print.retract_mm {
                self.filament_only(wiped_mm - print.retract_mm);
            }
        }
    }

    /// Goes back along the last bead and forth again while the filament is drawn back; gives how much of it was.
    fn wipe(&mut self) -> f64 {
        let print = &self.profile.print;
        let Some(end) = self.at.filter(|_| print.wipe_mm > 0.0) else { return 0.0 };
        let mut way = std::mem::take(&mut self.back);
        let forth: Vec<[i64; 2]> = way.iter().rev().skip(1).copied().chain([end]).collect();
        way.extend(forth);
        let lengths: Vec<f64> =
            [end].iter().chain(&way).zip(&way).map(|(a, b)| distance_mm(*a, *b)).collect();
        let length: f64 = lengths.iter().sum();
        if length < SHORTEST_WIPE_MM {
            return 0.0;
        }
        let speed = (print.retract_mm_s * length / print.retract_mm).min(print.travel_mm_s);
        let mut drawn = 0;
        for (to, step) in way.into_iter().zip(lengths) {
            let steps = filament_steps(print.retract_mm * step / length);
            drawn += steps;
            self.draw_back(to, steps, speed);
        }
        drawn as f64 / 1e5
    }

    fn draw_back(&mut self, to: [i64; 2], filament: i64, speed_mm_s: f64) {
        self.elapsed_s += self.at.map_or(0.0, |at| distance_mm(at, to)) / speed_mm_s;
        self.text.push_str("G1");
        self.place(to);
        self.text.push_str(" E");
        number(&mut self.text, -filament, FILAMENT_DECIMALS);
        self.feedrate(speed_mm_s);
    }

    fn unretract(&mut self) {
        if std::mem::take(&mut self.retracted) {
            self.filament_only(self.profile.print.retract_mm);
        }
    }

    fn filament_only(&mut self, mm: f64) {
        self.elapsed_s += mm.abs() / self.profile.print.retract_mm_s;
        self.text.push_str("G1 E");
        number(&mut self.text, filament_steps(mm), FILAMENT_DECIMALS);
        self.feedrate(self.profile.print.retract_mm_s);
    }

    fn lift(&mut self, z: i64) {
        if z != self.z {
            let speed = self.profile.machine.max_speed_mm_s[2].min(self.profile.print.travel_mm_s);
            if self.z != i64::MIN {
                self.elapsed_s += (z - self.z).unsigned_abs() as f64 / 1e3 / speed;
            }
            self.z = z;
            self.text.push_str("G0 Z");
            number(&mut self.text, z, COORDINATE_DECIMALS);
            self.feedrate(speed);
        }
    }

    fn bead(&mut self, bead: &Bead, moves: Vec<Piece>) {
        if self.kind != Some(bead.kind) {
            self.kind = Some(bead.kind);
            let over_air = self.profile.filament.bridge_fan_percent.max(self.layer_fan_percent);
            self.fan(if bead.kind.is_over_air() { over_air } else { self.layer_fan_percent });
            let _infallible = writeln!(self.text, ";TYPE:{}", bead.kind.gcode_name());
        }
        for piece in moves {
            self.owed_mm += piece.mm3 * self.filament_per_mm3;
            self.elapsed_s += piece.time_s();
            match piece.arc {
                Some(arc) => self.arc(steps(piece.to), arc, piece.speed_mm_s),
                None => self.go(steps(piece.to), Some(()), piece.speed_mm_s),
            }
        }
        self.back = way_back(&bead.points, self.profile.print.wipe_mm / 2.0);
    }

    /// Moves along an arc and pays out what is owed.
    fn arc(&mut self, to: [i64; 2], arc: Arc, speed_mm_s: f64) {
        let Some(from) = self.at else { return self.go(to, Some(()), speed_mm_s) };
        self.text.push_str(if arc.is_ccw { "G3" } else { "G2" });
        // Some firmwares take an axis that is not named for unchanged, others for the whole circle.
        for (axis, name) in [" X", " Y"].iter().enumerate() {
            self.text.push_str(name);
            number(&mut self.text, to[axis], COORDINATE_DECIMALS);
        }
        let centre = steps(arc.centre);
        for (axis, name) in [" I", " J"].iter().enumerate() {
            self.text.push_str(name);
            number(&mut self.text, centre[axis] - from[axis], COORDINATE_DECIMALS);
        }
        self.at = Some(to);
        self.pay();
        self.feedrate(speed_mm_s);
    }

    /// Moves in the bed's plane; with filament, pays out what is owed.
    fn go(&mut self, to: [i64; 2], filament: Option<()>, speed_mm_s: f64) {
        if self.at == Some(to) {
            return;
        }
        if let (Some(at), None) = (self.at, filament) {
            self.elapsed_s += distance_mm(at, to) / speed_mm_s;
        }
        self.text.push_str(if filament.is_some() { "G1" } else { "G0" });
        self.place(to);
        if filament.is_some() {
            self.pay();
        }
        self.feedrate(speed_mm_s);
    }

    /// The coordinates that change.
    fn place(&mut self, to: [i64; 2]) {
        for (axis, name) in [" X", " Y"].iter().enumerate() {
            if self.at.is_none_or(|at| at[axis] != to[axis]) {
                self.text.push_str(name);
                number(&mut self.text, to[axis], COORDINATE_DECIMALS);
            }
        }
        self.at = Some(to);
    }

    /// The filament that is owed, to the step.
    fn pay(&mut self) {
        let paid = filament_steps(self.owed_mm);
        self.owed_mm -= paid as f64 / 1e5;
        self.text.push_str(" E");
        number(&mut self.text, paid, FILAMENT_DECIMALS);
    }

    /// Ends a line with the speed, where it is another than before.
    fn feedrate(&mut self, speed_mm_s: f64) {
        #[expect(clippy::cast_possible_truncation, reason = "speeds are validated by the profile")]
        let feedrate = mm_min_from_mm_s(speed_mm_s).round().max(1.0) as i64;
        if feedrate != self.feedrate_mm_min {
            self.feedrate_mm_min = feedrate;
            self.text.push_str(" F");
            number(&mut self.text, feedrate, 0);
        }
        self.text.push('\n');
    }
}

#[expect(clippy::cast_possible_truncation, reason = "rounded to the grid on purpose; far below 2^63")]
fn filament_steps(mm: f64) -> i64 {
    (mm * 1e5).round() as i64
}

fn steps(p: Point2) -> [i64; 2] {
    [micrometres(p.x), micrometres(p.y)]
}

fn place([x, y]: [i64; 2]) -> Point2 {
    Point2::new(x as f64, y as f64) / 1e3
}

fn distance_mm(a: [i64; 2], b: [i64; 2]) -> f64 {
    ((a[0] - b[0]) as f64).hypot((a[1] - b[1]) as f64) / 1e3
}

/// Appends `steps / 10^decimals` without superfluous zeros.
fn number(text: &mut String, steps: i64, decimals: usize) {
    // The digits from the last one on, and the point.
    let mut reversed = [b'0'; 24];
    let mut n = 0;
    let mut rest = steps.unsigned_abs();
    for place in 0.. {
        let digit = u8::try_from(rest % 10).expect("a digit");
        rest /= 10;
        let is_whole = place >= decimals;
        if place == decimals && n > 0 {
            reversed[n] = b'.';
            n += 1;
        }
        if is_whole || digit > 0 || n > 0 {
            reversed[n] += digit;
            n += 1;
        }
        if is_whole && rest == 0 {
            break;
        }
    }
    if steps < 0 {
        text.push('-');
    }
    text.extend(reversed[..n].iter().rev().map(|&b| char::from(b)));
}

/// Volume of a layer's beads by the profile's bead model, mm³; the flow correction is not in it.
#[must_use]
pub fn volume_mm3(layer: &LayerPaths, profile: &Profile) -> f64 {
    let model = BeadModel::new(profile.print.bead_shape, layer.slot.height_mm);
    let segments = layer.beads.iter().flat_map(|b| b.points.windows(2));
    segments.map(|pair| model.volume_mm3(pair)).sum()
}

/// Time of the ways between a layer's beads, accelerations left out, s.
fn travel_s(layer: &LayerPaths, profile: &Profile) -> f64 {
    let end = |bead: &Bead| bead.points[bead.points.len() - 1].at;
    let way_mm = |(pair, travel): (&[Bead], &Travel)| {
        let way = [end(&pair[0])].into_iter().chain(travel.via.iter().copied()).chain([pair[1].points[0].at]);
        let way: Vec<Point2> = way.collect();
        way.windows(2).map(|p| (p[1] - p[0]).norm()).sum::<f64>()
    };
    let travels = layer.travels.iter().skip(1);
    layer.beads.windows(2).zip(travels).map(way_mm).sum::<f64>() / profile.print.travel_mm_s
}

fn speed(bead: &Bead, profile: &Profile, is_first_layer: bool) -> f64 {
    let print = &profile.print;
    let of_loop = |speed: f64| {
        let is_small = is_small_loop(bead, print.small_loop_mm);
        if is_small { speed.min(print.small_loop_mm_s) } else { speed }
    };
    let speed = match bead.kind {
        BeadKind::ExternalPerimeter => of_loop(print.external_perimeter_mm_s),
        BeadKind::Perimeter => of_loop(print.perimeter_mm_s),
        BeadKind::InternalInfill | BeadKind::SolidInfill => print.infill_mm_s,
        BeadKind::Bridge | BeadKind::Rib => print.bridge_mm_s,
        BeadKind::SupportMaterial | BeadKind::SupportInterface => print.perimeter_mm_s,
        BeadKind::SkirtBrim => print.first_layer_mm_s,
    };
    if is_first_layer { print.first_layer_mm_s.min(speed) } else { speed }
}

/// Whether a bead runs round less than so many mm and ends, but for a gap, where it began.
fn is_small_loop(bead: &Bead, length_mm: f64) -> bool {
    let (first, last) = (&bead.points[0], &bead.points[bead.points.len() - 1]);
    let is_loop =
        bead.points.len() > 3 && (last.at - first.at).norm() < 1.5 * first.width_mm.max(last.width_mm);
    let steps = bead.points.windows(2).map(|p| (p[1].at - p[0].at).norm());
    is_loop && steps.sum::<f64>() < length_mm
}

/// The way back from the end of a bead, so far or to its begin; without the end itself.
fn way_back(points: &[BeadPoint], length_mm: f64) -> Vec<[i64; 2]> {
    let mut way = Vec::new();
    let mut left_mm = length_mm;
    for pair in points.windows(2).rev() {
        let (from, to) = (pair[1].at, pair[0].at);
        let step = (to - from).norm();
        if left_mm <= 0.0 || step < 1e-9 {
            continue;
        }
        way.push(steps(from + (to - from) * (left_mm / step).min(1.0)));
        left_mm -= step;
    }
    way
}

#[cfg(test)]
mod tests;
