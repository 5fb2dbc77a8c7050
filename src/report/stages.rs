//! The comparison itself: outlines of all stages at all planes, measured in parallel, pooled in order.

use super::anatomy::{Branches, StageLumina};
use super::deviation::{Areas, Comparison, Figures, Outline, compare};
use super::image::{ImageBoundary, boundaries, median};
use super::lumen::{Expected, of_beads};
use super::picture::{ScannedScene, Scene, Window, frame_of, paint};
use super::record::Segment;
use super::scan::{self, Scanned, ScannedPlane};
use super::shares::{BranchFigures, Compared, by_branch};
use super::strokes::{self, Stroke};
use super::surface::Surface;
use super::uncertainty::Sides;
use super::verdict::Judged;
use super::{
    Basis, Block, BodyKind, Error, Histogram, Inputs, LayerFigures, Overall, PlaneFigures, REGISTRATION_MM,
    Report, Stage, Uncertainty, Verdict,
};
use super::{found, measures};
use crate::ct::Warning;
use crate::geom::{Contour, Point3, Region, SegmentIndex, Vector3};
use crate::progress::{Cancelled, Task};
use crate::sections::PlaneSections;
use crate::slice::Layer;
use crate::solid::CrossSection;
use crate::toolpath::{Bead, LayerPaths, StackFromBed};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Chord error of the solid's sections, mm: far below what is measured.
pub(super) const SECTION_TOLERANCE_MM: f64 = 1e-3;
/// Recorded segments farther than this from all planned ones of their layer are no part of the print (a line that
/// primes the nozzle), mm.
const ELSEWHERE_MM: f64 = 10.0;
/// CT plane and section are the same plane when they are nearer than this, mm.
const SAME_PLANE_MM: f64 = 0.01;

/// Measures, draws and judges.
///
/// # Errors
/// [`Error`]: nothing to report on, a job that does not belong to the case, interruption.
pub fn build(inputs: &Inputs<'_>, task: &Task<'_>) -> Result<Report, Error> {
    check(inputs)?;
    let n_planes = inputs.sections.planes.len();
    let counter =
        Counter { task, done: AtomicU64::new(0), total: (inputs.paths.layers.len() + 2 * n_planes) as u64 };
    let recorded = assign(inputs);
    let layers = layers(inputs, &recorded.of_layer, &counter)?;
    let planes: Vec<PlaneWork> = images(inputs)
        .into_par_iter()
        .enumerate()
        .map(|(k, seen)| plane(inputs, &layers, (k, seen), &counter))
        .collect::<Result<_, _>>()?;
    let figures: Vec<LayerFigures> = layers.iter().map(|l| l.figures).collect();
    let mut blocks = Stage::ALL.map(|stage| block(stage, inputs, &planes, &layers));
    let pixel_mm = inputs.image.map(|i| i.volume.pixel_spacing_xy_mm.into_iter().fold(0.0, f64::max));
    let branches = Branches::of(inputs.sections);
    let mut lumina = lumina(&branches, &planes);
    let (mut findings, unsure) = found::findings(inputs, &planes, &lumina, &branches.names());
    let sections: Vec<(f64, &CrossSection)> =
        inputs.sections.planes.iter().map(|p| p.z_mm).zip(planes.iter().map(|p| &p.section)).collect();
    let scanned = inputs.scan.map(|volume| scan::measured(inputs, volume, &sections, task)).transpose()?;
    let pictures = pictures(inputs, &planes, &layers, scanned.as_ref(), &counter)?;
    let mut scan = scanned.as_ref().map(|s| s.stage(branches.z_mm()));
    if let Some(scanned) = &scanned {
        findings.extend(scanned.findings(&lumina[SOLID], &branches, task)?);
        lumina.extend(scanned.lumina(&branches));
    }
    let uncertainty = Uncertainty::of(&planes);
    let detail = Detail { branches: &branches, lumina: &lumina, layers: &layers };
    for (stage, block) in Stage::ALL.into_iter().zip(&mut blocks) {
        let compared: Vec<_> = planes.iter().map(|p| p.comparisons[stage as usize].as_ref().ok()).collect();
        detail.add(stage, block, &compared, uncertainty.sides(stage));
    }
    if let (Some(scan), Some(scanned)) = (&mut scan, &scanned) {
        let compared: Vec<_> = scanned.planes.iter().map(ScannedPlane::comparison).collect();
        let sides = scan.uncertainty_mm.sides();
        detail.add(Stage::Scan, &mut scan.block, &compared, sides);
    }
    let section =
        |z_mm: f64| section_lumen(&inputs.solid.section(z_mm, SECTION_TOLERANCE_MM), inputs.body).clone();
    let mut anatomy = branches.measure(&lumina, &section);
    let scanned_mm = scan.as_ref().and_then(|s| s.uncertainty_mm.place);
    uncertainty.state(&mut anatomy, scanned_mm);
    let place_mm = |stage: &str| uncertainty.place_mm(stage, scanned_mm);
    let walls = measures::walls(inputs, &planes, &layers, scanned.as_ref(), &place_mm);
    let amounts = measures::amounts(inputs, &planes, scanned.as_ref());
    let judged = Judged {
        pixel_mm,
        meant: if compensation_mm(inputs) == 0.0 { "contours" } else { "planned" },
        blocks: &blocks,
        unseen: &unseen(&planes),
        findings: &findings,
        anatomy: &anatomy,
        walls: &walls,
        amounts: &amounts,
        scan: scan.as_ref(),
    };
    Ok(Report {
        body: inputs.body,
        origin: inputs.record.origin,
        about: inputs.about.clone(),
        verdict: Verdict::of(inputs.gate, &judged)
            .resting_on(Basis::of(inputs.record.origin, scan.is_some())),
        anatomy,
        walls,
        amounts,
        uncertainty,
        scan,
        triangles: inputs.triangles.to_vec(),
        plane_z_mm: inputs.sections.plane_z_mm(),
        surface: Surface::of(inputs, &pictures),
        notes: notes(inputs, &recorded, &figures, &planes)
            .into_iter()
            .chain(unsure)
            .chain(scanned.iter().flat_map(Scanned::notes))
            .collect(),
        findings,
        layers: figures,
        blocks,
        pictures,
    })
}

/// What the figures of a stage are shared out by.
struct Detail<'a> {
    branches: &'a Branches,
    lumina: &'a [StageLumina],
    layers: &'a [LayerWork],
}

impl Detail<'_> {
    /// Gives a block its uncertainties and the figures of its branches.
    fn add(&self, stage: Stage, block: &mut Block, compared: &[Option<&Comparison>], sides: Option<Sides>) {
        let state = |figures: &mut Figures, planes: &[&Comparison], areas: Option<Areas>| {
            if let Some(sides) = sides {
                figures.uncertainty = sides.of(figures, planes, areas);
            }
        };
        let areas = |planes: &[&Comparison]| Some(Areas::sum(planes.iter().filter_map(|c| c.areas.as_ref())));
        let of_material = (stage == Stage::Deposition).then_some(self.layers);
        if let Some(overall) = &mut block.overall {
            let planes: Vec<&Comparison> = compared.iter().flatten().copied().collect();
            let material = of_material.map(|layers| Areas::sum(layers.iter().map(|l| &l.areas)));
            state(&mut overall.figures, &planes, material.or_else(|| areas(&planes)));
        }
        for (entry, comparison) in block.planes.iter_mut().zip(compared) {
            let own: Vec<&Comparison> = comparison.iter().copied().collect();
            let at = |layers: &[LayerWork]| {
                layers.iter().find(|l| l.figures.ct_plane == Some(entry.plane)).map(|l| l.areas)
            };
            let material = of_material.and_then(at);
            state(&mut entry.figures, &own, material.or_else(|| areas(&own)));
        }
        let [reference, tested] = lumina_of(stage).map(|i| self.lumina.get(i));
        let (Some(reference), Some(tested)) = (reference, tested) else { return };
        let shares = by_branch(self.branches, Compared { planes: compared, reference, tested });
        let named = self.branches.names().into_iter().zip(shares).filter(|(_, planes)| !planes.is_empty());
        block.branches = named
            .map(|(branch, planes)| {
                let planes: Vec<&Comparison> = planes.iter().collect();
                let mut figures = Figures::of(planes.iter().copied());
                state(&mut figures, &planes, areas(&planes));
                BranchFigures { branch, n_planes: planes.len(), figures }
            })
            .collect();
    }
}

/// The two lumina that a stage compares, by their places in [`STAGES`] and what a scan adds.
const fn lumina_of(stage: Stage) -> [usize; 2] {
    match stage {
        Stage::Total => [0, STAGES.len() - 1],
        Stage::Scan => [SOLID, STAGES.len()],
        stage => [stage as usize, stage as usize + 1],
    }
}

struct Counter<'a> {
    task: &'a Task<'a>,
    done: AtomicU64,
    total: u64,
}

impl Counter<'_> {
    fn tick(&self) -> Result<(), Cancelled> {
        self.task.check()?;
        self.task.report(self.done.fetch_add(1, Ordering::Relaxed) + 1, self.total);
        Ok(())
    }
}

/// Refuses what cannot be compared: nothing there, tilted, or not the job of this case.
fn check(inputs: &Inputs<'_>) -> Result<(), Error> {
    if inputs.sections.planes.is_empty() {
        return Err(Error::NoPlanes);
    }
    if inputs.paths.layers.is_empty() {
        return Err(Error::NoLayers);
    }
    let up = inputs.paths.bed_from_stack.rotate(Vector3::z());
    let tilt_deg = up.z.clamp(-1.0, 1.0).acos().to_degrees();
    if tilt_deg > 1e-3 {
        return Err(Error::Tilted { tilt_deg });
    }
    // Compensations of the first layer are meant; at the CT planes nothing may move.
    let at_planes = inputs.paths.layers.iter().enumerate().filter(|(_, l)| l.slot.ct_plane.is_some());
    let offsets = at_planes.filter_map(|(i, l)| Some((i, registration_mm(inputs, l)?)));
    match offsets.max_by(|a, b| a.1.total_cmp(&b.1)) {
        None => Err(Error::Unchecked),
        Some((layer, off_mm)) if off_mm > REGISTRATION_MM => Err(Error::Registration { layer, off_mm }),
        Some(_) => Ok(()),
    }
}

/// How far the planned lumen (a cast's material) lies off the layer's after the transform, mm, without a fit: the farthest that a corner
/// of one outline lies from the other, both ways; infinite where one of them has nothing. `None` where neither has.
fn registration_mm(inputs: &Inputs<'_>, paths: &LayerPaths) -> Option<f64> {
    let layer = layer_of(inputs, paths)?;
    let compensation = &inputs.paths.compensation;
    // By how much each outline is meant to lie outward on the bed: there outlines are moved, after the part was enlarged.
    let (planned, sliced, larger_mm) = match inputs.body {
        BodyKind::Wall => (&paths.lumen, &layer.lumen, compensation.lumen_mm),
        BodyKind::Cast => (&paths.material, &layer.material, -compensation.material_mm),
    };
    let back = inputs.paths.stack_from_bed();
    let (planned, by_mm) = (moved(planned, &back), back.length_mm(larger_mm));
    let meant = if by_mm == 0.0 { sliced.clone() } else { sliced.offset(by_mm, SECTION_TOLERANCE_MM) };
    if planned.is_empty() && meant.is_empty() {
        return None;
    }
    let [one, other] = [&planned, &meant].map(|r| SegmentIndex::try_new(&r.contours));
    let farthest = |from: &Region, to: &SegmentIndex| {
        let corners = from.contours.iter().flat_map(|c| &c.points);
        corners.map(|p| to.nearest(*p).distance_mm).fold(0.0, f64::max)
    };
    Some(
        one.zip(other)
            .map_or(f64::INFINITY, |(one, other)| farthest(&planned, &other).max(farthest(&meant, &one))),
    )
}

/// The layer of the case that a layer of the job prints.
pub(super) fn layer_of<'a>(inputs: &Inputs<'a>, paths: &LayerPaths) -> Option<&'a Layer> {
    let z = paths.slot.z_mid_mm;
    let after = inputs.layers.partition_point(|l| l.slot.z_mid_mm < z - 1e-6);
    inputs.layers.get(after).filter(|l| (l.slot.z_mid_mm - z).abs() < 1e-6)
}

fn moved(region: &Region, by: &StackFromBed) -> Region {
    let contour = |c: &Contour| Contour::new(c.points.iter().map(|&p| by.point(p)).collect());
    Region::new(region.contours.iter().map(contour).collect())
}

/// The recorded strokes of every layer, and what belongs to none. Stack frame.
#[derive(Default)]
struct Recorded {
    of_layer: Vec<Vec<Stroke>>,
    n_stray: usize,
    stray_mm3: f64,
    n_elsewhere: usize,
    elsewhere_mm3: f64,
    volume_mm3: f64,
}

/// Gives every recorded segment to the layer whose top it was printed at.
fn assign(inputs: &Inputs<'_>) -> Recorded {
    let layers = &inputs.paths.layers;
    let back = inputs.paths.stack_from_bed();
    let boxes: Vec<_> = layers.iter().map(|l| bounds_of(l).map(|b| b.grown(ELSEWHERE_MM))).collect();
    let mut recorded = Recorded { of_layer: vec![Vec::new(); layers.len()], ..Recorded::default() };
    let mut last: Option<(usize, Point3)> = None;
    for segment in &inputs.record.segments {
        recorded.volume_mm3 += segment.volume_mm3;
        let Some(layer) = layer_at(layers, 0.5 * (segment.from.z + segment.to.z)) else {
            recorded.n_stray += 1;
            recorded.stray_mm3 += segment.volume_mm3;
            last = None;
            continue;
        };
        let near = boxes[layer].is_some_and(|b| b.contains(segment.from.xy()) || b.contains(segment.to.xy()));
        if !near {
            recorded.n_elsewhere += 1;
            recorded.elsewhere_mm3 += segment.volume_mm3;
            last = None;
            continue;
        }
        let goes_on = last.is_some_and(|(l, end)| l == layer && (end - segment.from).norm() < 2e-3);
        append(&mut recorded.of_layer[layer], segment, goes_on, &back);
        last = Some((layer, segment.to));
    }
    recorded
}

fn append(strokes: &mut Vec<Stroke>, segment: &Segment, goes_on: bool, back: &StackFromBed) {
    let place = |p: Point3| back.point(p.xy());
    if !goes_on || strokes.is_empty() {
        strokes.push(Stroke { points: vec![place(segment.from)], widths_mm: Vec::new() });
    }
    if let Some(stroke) = strokes.last_mut() {
        stroke.points.push(place(segment.to));
        stroke.widths_mm.push(back.length_mm(segment.width_mm));
    }
}

fn bounds_of(layer: &LayerPaths) -> Option<crate::geom::Bounds2> {
    crate::geom::Bounds2::of(layer.beads.iter().flat_map(|b| b.points.iter().map(|p| p.at)))
}

/// The layer whose nozzle height is nearest, within a quarter of its height.
fn layer_at(layers: &[LayerPaths], z_mm: f64) -> Option<usize> {
    let above = layers.partition_point(|l| l.z_mm < z_mm);
    let near = |i: usize| (layers[i].z_mm - z_mm).abs();
    let candidates = above.saturating_sub(1)..(above + 1).min(layers.len());
    let best = candidates.min_by(|&a, &b| near(a).total_cmp(&near(b)))?;
    (near(best) <= 0.25 * layers[best].slot.height_mm).then_some(best)
}

/// What one layer of the job came to.
pub(super) struct LayerWork {
    figures: LayerFigures,
    areas: Areas,
    /// Unions of planned (the part alone) and recorded beads; only at CT planes.
    pub(super) beads: Option<[Region; 2]>,
}

fn layers(
    inputs: &Inputs<'_>,
    recorded: &[Vec<Stroke>],
    counter: &Counter<'_>,
) -> Result<Vec<LayerWork>, Cancelled> {
    let back = inputs.paths.stack_from_bed();
    inputs
        .paths
        .layers
        .par_iter()
        .zip(recorded)
        .enumerate()
        .map(|(i, (paths, recorded))| {
            counter.tick()?;
            Ok(layer(i, paths, recorded, &back))
        })
        .collect()
}

fn layer(i: usize, paths: &LayerPaths, recorded: &[Stroke], back: &StackFromBed) -> LayerWork {
    let stroke = |bead: &Bead| Stroke {
        points: bead.points.iter().map(|p| back.point(p.at)).collect(),
        widths_mm: bead
            .points
            .iter()
            .map(|p| back.length_mm(p.width_mm))
            .take(bead.points.len().max(2) - 1)
            .collect(),
    };
    let (around, part): (Vec<&Bead>, Vec<&Bead>) = paths.beads.iter().partition(|b| !b.kind.is_part());
    let part = strokes::union(&part.into_iter().map(stroke).collect::<Vec<_>>());
    let deposited = strokes::union(recorded);
    let areas = if around.is_empty() {
        Areas::of(&part, &deposited)
    } else {
        let around = strokes::union(&around.into_iter().map(stroke).collect::<Vec<_>>());
        Areas::of(&part.union(&around), &deposited)
    };
    let figures = LayerFigures {
        layer: i,
        z_mm: paths.slot.z_mid_mm,
        ct_plane: paths.slot.ct_plane,
        planned_area_mm2: Some(areas.reference_mm2),
        recorded_area_mm2: Some(areas.tested_mm2),
        iou: areas.iou(),
    };
    LayerWork { figures, areas, beads: paths.slot.ct_plane.map(|_| [part, deposited]) }
}

/// Everything about one CT plane.
pub(super) struct PlaneWork {
    /// Plane of the volume.
    pub(super) volume_plane: Option<usize>,
    pub(super) image: Option<ImageBoundary>,
    pub(super) contours: Outline,
    pub(super) section: CrossSection,
    pub(super) solid: Outline,
    /// Layer of the job at this plane.
    pub(super) layer_idx: Option<usize>,
    pub(super) sliced: Option<Outline>,
    pub(super) planned: Option<Outline>,
    pub(super) recorded: Option<Outline>,
    pub(super) comparisons: [Result<Comparison, String>; 6],
}

/// The plane of the volume at a plane of the contours, and what it shows.
type InImage = (Option<usize>, Option<ImageBoundary>);

fn images(inputs: &Inputs<'_>) -> Vec<InImage> {
    let planes = &inputs.sections.planes;
    let Some(image) = inputs.image else { return planes.iter().map(|_| (None, None)).collect() };
    let z_mm = &image.volume.plane_z_mm;
    let at = |sections: &PlaneSections| z_mm.iter().position(|z| (z - sections.z_mm).abs() < SAME_PLANE_MM);
    let searched: Vec<_> = planes.iter().map(|p| (at(p), p.contours.as_slice())).collect();
    searched.iter().map(|s| s.0).zip(boundaries(image, &searched)).collect()
}

fn plane(
    inputs: &Inputs<'_>,
    layers: &[LayerWork],
    (k, (volume_plane, image)): (usize, InImage),
    counter: &Counter<'_>,
) -> Result<PlaneWork, Cancelled> {
    counter.tick()?;
    let sections = &inputs.sections.planes[k];
    let section = inputs.solid.section(sections.z_mm, SECTION_TOLERANCE_MM);
    let layer_idx = layers.iter().position(|l| l.figures.ct_plane == Some(k));
    let layer = layer_idx.and_then(|i| layer_of(inputs, &inputs.paths.layers[i]));
    let beads = layer_idx.and_then(|i| layers[i].beads.as_ref());
    let lumen_of = |beads: &Region, layer: &Layer| -> Outline {
        let expected = Expected { lumen: layer_lumen(layer, inputs.body), material: &layer.material };
        of_beads(beads, expected, inputs.body).into()
    };
    let mut work = PlaneWork {
        volume_plane,
        contours: sections.region().into(),
        solid: section_lumen(&section, inputs.body).clone().into(),
        section,
        sliced: layer.map(|l| layer_lumen(l, inputs.body).clone().into()),
        planned: layer.zip(beads).map(|(l, b)| lumen_of(&b[0], l)),
        recorded: layer.zip(beads).map(|(l, b)| lumen_of(&b[1], l)),
        layer_idx,
        image,
        comparisons: std::array::from_fn(|_| Err(String::new())),
    };
    work.comparisons = Stage::ALL.map(|stage| work.compare(stage, inputs.image.is_some()));
    Ok(work)
}

pub(super) fn section_lumen(section: &CrossSection, body: BodyKind) -> &Region {
    match body {
        BodyKind::Wall => &section.lumen,
        BodyKind::Cast => &section.outer,
    }
}

pub(super) fn layer_lumen(layer: &Layer, body: BodyKind) -> &Region {
    match body {
        BodyKind::Wall => &layer.lumen,
        BodyKind::Cast => &layer.material,
    }
}

impl PlaneWork {
    fn compare(&self, stage: Stage, has_image: bool) -> Result<Comparison, String> {
        let no_image = if has_image { "the CT has no plane at this height" } else { NO_CT };
        let no_layer = "no layer of the job stands for this plane";
        let image = || self.image.as_ref().map(|i| &i.outline).ok_or(no_image);
        let sliced = || self.sliced.as_ref().ok_or(no_layer);
        let planned = || self.planned.as_ref().ok_or(no_layer);
        let recorded = || self.recorded.as_ref().ok_or(no_layer);
        let (reference, tested, missing) = match stage {
            Stage::Segmentation => (image()?, &self.contours, ["edge in the image", "contour"]),
            Stage::Reconstruction => (&self.contours, &self.solid, ["contour", "lumen of the solid"]),
            Stage::Slicing => (&self.solid, sliced()?, ["lumen of the solid", "lumen in the layer"]),
            Stage::Toolpath => (sliced()?, planned()?, ["lumen in the layer", "lumen in the planned beads"]),
            Stage::Deposition => {
                (planned()?, recorded()?, ["lumen in the planned beads", "lumen in the deposited material"])
            }
            Stage::Total => (image()?, recorded()?, ["edge in the image", "lumen in the deposited material"]),
            Stage::Scan => return Err("a scan is compared by itself".into()),
        };
        let absent = [reference, tested].map(|o| o.region.is_empty());
        match absent.iter().position(|&absent| absent) {
            Some(i) => Err(format!("no {} here", missing[i])),
            None => compare(reference, tested).map_err(str::to_owned),
        }
    }
}

const NO_CT: &str = "the case was made from ready contours, there is no CT to compare with";

fn block(stage: Stage, inputs: &Inputs<'_>, planes: &[PlaneWork], layers: &[LayerWork]) -> Block {
    let of_image = matches!(stage, Stage::Segmentation | Stage::Total);
    if of_image && inputs.image.is_none() {
        return Block { reason: Some(NO_CT.into()), ..Block::default() };
    }
    let measured = planes.iter().filter_map(|p| p.comparisons[stage as usize].as_ref().ok());
    let n_planes = measured.clone().count();
    let histogram = Histogram::of(measured.clone());
    let mut overall = Overall { figures: Figures::of(measured), n_planes, ..Overall::default() };
    if stage == Stage::Deposition {
        deposited_material(&mut overall, layers);
    }
    if of_image {
        overall.edge_found_part = found_part(planes);
    }
    let something = n_planes > 0 || overall.iou_mean.is_some();
    Block {
        branches: Vec::new(),
        overall: something.then_some(overall),
        histogram,
        planes: planes
            .iter()
            .enumerate()
            .map(|(k, work)| plane_figures(stage, k, inputs.sections.planes[k].z_mm, work, layers))
            .collect(),
        reason: (!something).then(|| "no plane could be measured".into()),
    }
}

/// Dice, area and IoU of the material over all layers take the place of those of the lumen.
fn deposited_material(overall: &mut Overall, layers: &[LayerWork]) {
    let areas = Areas::sum(layers.iter().map(|l| &l.areas));
    overall.figures.dice = areas.dice();
    overall.figures.area_error_percent = areas.error_percent();
    let ious: Vec<f64> = layers.iter().filter_map(|l| l.areas.iou()).collect();
    overall.iou_min = ious.iter().copied().reduce(f64::min);
    overall.iou_mean = (!ious.is_empty()).then(|| ious.iter().sum::<f64>() / ious.len() as f64);
}

fn found_part(planes: &[PlaneWork]) -> Option<f64> {
    let images = planes.iter().filter_map(|p| p.image.as_ref());
    let (found, points) = images.fold((0, 0), |(f, n), i| (f + i.n_found, n + i.n_points));
    (points > 0).then(|| found as f64 / points as f64)
}

/// Planes with contours whose total was not measured, or rests on less than half of the outline's places.
fn unseen(planes: &[PlaneWork]) -> Vec<usize> {
    let is_seen = |p: &PlaneWork| {
        let is_clear = p.image.as_ref().is_some_and(|i| 2 * i.n_found >= i.n_points);
        is_clear && p.comparisons[Stage::Total as usize].is_ok()
    };
    (0..planes.len()).filter(|&k| !planes[k].contours.region.is_empty() && !is_seen(&planes[k])).collect()
}

fn plane_figures(
    stage: Stage,
    plane: usize,
    z_mm: f64,
    work: &PlaneWork,
    layers: &[LayerWork],
) -> PlaneFigures {
    let mut entry = match &work.comparisons[stage as usize] {
        Ok(comparison) => {
            PlaneFigures { figures: Figures::of(std::iter::once(comparison)), ..PlaneFigures::default() }
        }
        Err(reason) => PlaneFigures { reason: Some(reason.clone()), ..PlaneFigures::default() },
    };
    (entry.plane, entry.z_mm) = (plane, z_mm);
    if let (Stage::Deposition, Some(i)) = (stage, work.layer_idx) {
        let areas = layers[i].areas;
        entry.figures.dice = areas.dice();
        entry.figures.area_error_percent = areas.error_percent();
        entry.iou = areas.iou();
    }
    entry
}

/// How a stage's lumen is found in the work of a plane.
pub(super) type Lumen = fn(&PlaneWork) -> Option<&Region>;

/// The place of the solid in [`STAGES`].
const SOLID: usize = 2;
/// Every stage that has a lumen.
pub(super) const STAGES: [(&str, Lumen); 6] = [
    ("image", |p| p.image.as_ref().map(ImageBoundary::region)),
    ("contours", |p| Some(&p.contours.region)),
    ("solid", |p| Some(&p.solid.region)),
    ("layers", |p| p.sliced.as_ref().map(|o| &o.region)),
    ("planned", |p| p.planned.as_ref().map(|o| &o.region)),
    ("recorded", |p| p.recorded.as_ref().map(|o| &o.region)),
];

/// The lumina of all stages, given to the branches.
fn lumina(branches: &Branches, planes: &[PlaneWork]) -> Vec<StageLumina> {
    let of = |stage: &'static str, get: Lumen| StageLumina {
        stage,
        planes: planes
            .par_iter()
            .enumerate()
            .map(|(k, work)| branches.share_out(get(work).unwrap_or(&Region::default()), k))
            .collect(),
    };
    STAGES.map(|(stage, get)| of(stage, get)).into()
}

fn pictures(
    inputs: &Inputs<'_>,
    planes: &[PlaneWork],
    layers: &[LayerWork],
    scanned: Option<&Scanned<'_>>,
    counter: &Counter<'_>,
) -> Result<Vec<super::Picture>, Error> {
    let regions = planes.iter().flat_map(|p| [&p.contours.region, &p.section.outer]);
    let frame = frame_of(regions.filter_map(Region::bounds));
    let levels: Vec<[f64; 2]> =
        planes.iter().filter_map(|p| p.image.as_ref()).flat_map(|i| i.levels_hu.iter().copied()).collect();
    let window = Window::of_levels(
        median(levels.iter().map(|l| l[0])),
        median(levels.iter().map(|l| l[1])),
        inputs.image.map(|i| i.volume),
    );
    let back = inputs.paths.stack_from_bed();
    let all = planes.par_iter().enumerate().map(|(k, work)| {
        counter.tick()?;
        let centre_lines = work.layer_idx.map_or_else(Vec::new, |i| {
            let beads = inputs.paths.layers[i].beads.iter();
            beads.map(|b| b.points.iter().map(|p| back.point(p.at)).collect()).collect()
        });
        paint(&Scene {
            plane: k,
            z_mm: inputs.sections.planes[k].z_mm,
            frame,
            image: inputs.image.map(|i| i.volume).zip(work.volume_plane),
            window,
            patient_from_stack: inputs.sections.patient_from_stack,
            recorded: work.layer_idx.and_then(|i| layers[i].beads.as_ref()).map(|b| &b[1]),
            centre_lines,
            solid: &work.section,
            contours: &inputs.sections.planes[k].contours,
            reference: Some(work.image.as_ref().map_or(&work.contours, |i| &i.outline)),
            deposited: work.recorded.as_ref().map(|o| &o.region),
            scanned: scanned.and_then(|s| s.planes.get(k)).map(|own| ScannedScene {
                model: &work.solid,
                lumen: &own.lumen,
                material: &own.material,
            }),
        })
    });
    all.collect()
}

/// What the reader must know beside the figures.
fn notes(
    inputs: &Inputs<'_>,
    recorded: &Recorded,
    layers: &[LayerFigures],
    planes: &[PlaneWork],
) -> Vec<Warning> {
    let mut notes = Vec::new();
    let mut note = |code: &str, text: String| notes.push(Warning { code: format!("report.{code}"), text });
    if let Some(text) = extrapolated(inputs) {
        note("extrapolated_ends", text);
    }
    if let Some(text) = compensated(inputs) {
        note("compensated", text);
    }
    if inputs.image.is_none() {
        note("no_ct", format!("{NO_CT}: segmentation and total error are not known."));
    }
    let unseen = planes.iter().filter(|p| p.volume_plane.is_none()).count();
    if inputs.image.is_some() && unseen > 0 {
        note("planes_without_image", format!("{unseen} planes of the contours have no plane in the CT."));
    }
    if let Some(part) = found_part(planes).filter(|p| *p < 0.9) {
        note(
            "unclear_edges",
            format!(
                "Only {:.0} % of the places along the contours show a clear edge in the image; the figures against the image rest on these.",
                100.0 * part
            ),
        );
    }
    let without = planes.iter().filter(|p| p.layer_idx.is_none()).count();
    if without > 0 {
        note("planes_without_layer", format!("{without} CT planes have no layer in the job."));
    }
    let missing: Vec<usize> = layers
        .iter()
        .filter(|l| l.planned_area_mm2 > Some(0.0) && l.recorded_area_mm2 == Some(0.0))
        .map(|l| l.layer)
        .collect();
    if let (Some(first), Some(last)) = (missing.first(), missing.last()) {
        note(
            "layers_not_deposited",
            format!(
                "{} of {} layers were not deposited, from layer {first} to layer {last}.",
                missing.len(),
                layers.len()
            ),
        );
    }
    if recorded.n_stray > 0 {
        note(
            "deposited_between_layers",
            format!(
                "{} pieces ({:.2} mm\u{b3}) were deposited at heights that belong to no layer; no figure counts them.",
                recorded.n_stray, recorded.stray_mm3
            ),
        );
    }
    if recorded.n_elsewhere > 0 {
        note(
            "deposited_elsewhere",
            format!(
                "{} pieces ({:.2} mm\u{b3}) were deposited more than {ELSEWHERE_MM:.0} mm beside the job (such as a line that primes the nozzle); no figure counts them.",
                recorded.n_elsewhere, recorded.elsewhere_mm3
            ),
        );
    }
    note(
        "obliquity",
        "Areas and diameters are measured in the CT planes, not across the vessel's axis: where a branch runs obliquely, area and equivalent diameter are too large; the minimum diameter is not.".into(),
    );
    notes.extend(inputs.record.warnings.iter().chain(inputs.warnings).cloned());
    notes
}

/// By how much the printed outlines are meant to lie outward of the layers', in the cold part, mm.
pub(super) fn compensation_mm(inputs: &Inputs<'_>) -> f64 {
    let compensation = &inputs.paths.compensation;
    // Beads at the lumen lie where both moves put them; a cast has no lumen's outline.
    let on_bed_mm = match inputs.body {
        BodyKind::Wall => compensation.lumen_mm + compensation.material_mm,
        BodyKind::Cast => -compensation.material_mm,
    };
    inputs.paths.stack_from_bed().length_mm(on_bed_mm)
}

/// What is to be known of outlines that are meant to lie off the layers'.
fn compensated(inputs: &Inputs<'_>) -> Option<String> {
    let cold_mm = compensation_mm(inputs);
    (cold_mm != 0.0).then(|| {
        format!("The profile compensates what holes shrink and beads bulge: the lumen is planned {cold_mm:+.3} mm outward, measured in the cold part. The figures of planned and recorded outlines contain it.")
    })
}

/// How much of the body lies beyond the outermost CT planes.
fn extrapolated(inputs: &Inputs<'_>) -> Option<String> {
    let z = inputs.sections.plane_z_mm();
    let (first, last) = (*z.first()?, *z.last()?);
    let [low, high] = inputs.solid.z_range_mm();
    let (below, above) = ((first - low).max(0.0), (high - last).max(0.0));
    let slots = inputs.paths.layers.iter().map(|l| l.slot.z_mid_mm);
    let n = slots.filter(|z| *z < first - 1e-6 || *z > last + 1e-6).count();
    (below + above > 1e-3).then(|| {
        format!("The lowest {below:.2} mm and the highest {above:.2} mm of the body ({n} layers) lie beyond the outermost CT planes: they are extrapolated, no image shows them, and no figure against the image covers them.")
    })
}
