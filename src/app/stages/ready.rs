//! A segmentation made elsewhere to contours: `sections.json`, `segmentation.json`, with a CT `volume.bin`.

use super::segment::{
    Image, SECTIONS_FILE, SEGMENTATION_FILE, SegmentationNote, VOLUME_FILE, hash_of_source, lumen_bounds,
};
use super::to_json;
use crate::app::case::MadeFrom;
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::{Made, Session, hash_of};
use crate::app::settings::{Settings, Source};
use crate::app::volume_file;
use crate::ct::{HEIGHT_SLACK_MM, SeriesMark, Volume, Warning};
use crate::geom::{Contour, Point3, Vector2};
use crate::progress::Task;
use crate::ready::{self, Label, Ready};
use crate::sections::ready::DrawnStack;
use crate::sections::{self, SectionStack};
use crate::segment::Polarity;

impl Session<'_> {
    /// Takes the contours of a ready segmentation.
    pub(super) fn take_ready(&mut self) -> Result<(), Error> {
        let loaded = self.with_numbered_label()?;
        self.stage(Stage::Segment, |session, task| session.take_over(loaded, task))
    }

    /// Replaces a structure's name, which must not be kept, by its number; what had to be read for it.
    fn with_numbered_label(&mut self) -> Result<Option<Ready>, Error> {
        let Source::Ready { has_ct, label: Some(Label::Name(_)) } = self.settings().source else {
            return Ok(None);
        };
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let loaded = self.load_ready(&task)?;
        let source = Source::Ready { has_ct, label: Some(Label::Number(loaded.number)) };
        let settings = Settings { source, ..self.settings().clone() };
        self.case.set_settings(settings);
        Ok(Some(loaded))
    }

    fn load_ready(&self, task: &Task<'_>) -> Result<Ready, Error> {
        let unknown = || Error::SegmentationUnknown(self.case.dir().to_owned());
        let path = self.ready.as_deref().filter(|p| p.exists()).ok_or_else(unknown)?;
        let label = match &self.settings().source {
            Source::Ready { label, .. } => label.as_ref(),
            _ => None,
        };
        Ok(ready::load(path, label, task)?)
    }

    pub(super) fn ready_made_from(&self, has_ct: bool, label: Option<&Label>) -> Result<MadeFrom, Error> {
        let parameters = hash_of(&(&self.settings().segment, label));
        let mut made_from =
            MadeFrom::from([("segmentation", self.ready_hash()?), ("parameters", parameters)]);
        if has_ct {
            made_from.insert("ct", self.ct_hash()?);
        }
        Ok(made_from)
    }

    /// The hash of the segmentation's files; that of the last time where nobody knows where they are.
    pub(crate) fn ready_hash(&self) -> Result<String, Error> {
        if let Some(known) = self.ready_hash.get() {
            return Ok(known.clone());
        }
        if let Some(path) = self.ready.as_deref().filter(|p| p.exists()) {
            let files = ready::files_of(path)?;
            let hash = hash_of_source(&files, self.case.id()).map_err(ready::Error::from)?;
            return Ok(self.ready_hash.get_or_init(|| hash).clone());
        }
        let before = self.case.made_from(Stage::Segment).and_then(|m| m.get("segmentation"));
        before.cloned().ok_or_else(|| Error::SegmentationUnknown(self.case.dir().to_owned()))
    }

    fn take_over(&mut self, loaded: Option<Ready>, task: &Task<'_>) -> Result<Made, Error> {
        let (image, mut warnings) = match self.has_image() {
            true => self.load_own_ct(task)?,
            false => (None, Vec::new()),
        };
        self.note(Stage::Segment, "reading the segmentation");
        let Ready { drawn, warnings: odd, reference, absent, .. } = match loaded {
            Some(loaded) => loaded,
            None => self.load_ready(task)?,
        };
        warnings.extend(odd);
        if let Some(Image { volume, frame, .. }) = &image {
            ready::place::check_reference(volume, frame, &reference, &mut warnings)?;
        }
        let (ct, series) = image.map_or((None, None), |image| (Some(image.volume), image.series));
        let drawn = match &ct {
            Some(ct) => ready::place::onto(ct, drawn, &mut warnings)?,
            None => drawn,
        };
        let drawn = between(drawn, self.settings().segment.z_mm)?;
        let allow_gaps = self.settings().segment.allow_gaps;
        let drawn = ready::gaps::resolve(drawn, absent, ct.as_ref(), allow_gaps, &mut warnings)?;
        self.note(Stage::Segment, "drawing its contours");
        let extracted = sections::ready::from_drawn(drawn, &sections::Params::default(), task)?;
        warnings.extend(extracted.warnings);
        let note = note(&extracted.stack, ct.as_ref(), series, warnings);
        self.keep_ready(extracted.stack, ct.as_ref(), note)
    }

    fn load_own_ct(&self, task: &Task<'_>) -> Result<(Option<Image>, Vec<Warning>), Error> {
        let unknown = || Error::CtUnknown(self.case.dir().to_owned());
        let path = self.ct.as_deref().filter(|ct| ct.exists()).ok_or_else(unknown)?;
        let mut image = self.load_ct(path, task)?;
        let warnings = std::mem::take(&mut image.warnings);
        Ok((Some(image), warnings))
    }

    fn keep_ready(
        &mut self,
        stack: SectionStack,
        ct: Option<&Volume>,
        note: SegmentationNote,
    ) -> Result<Made, Error> {
        let unwritable = |source| Error::SectionsFile { path: self.case.path(SECTIONS_FILE), source };
        let document = sections::format::to_json(&stack).map_err(unwritable)?;
        let staging = self.case.staging()?;
        staging.write(SECTIONS_FILE, document.as_bytes())?;
        if let Some(ct) = ct {
            let kept = around(ct, &stack);
            staging.write(VOLUME_FILE, &volume_file::to_bytes(&kept))?;
            self.held.volume = Some(kept);
        }
        staging.write(SEGMENTATION_FILE, &to_json(&note))?;
        let n_contours: usize = stack.planes.iter().map(|p| p.contours.len()).sum();
        let summary = format!("{} planes, {n_contours} contours of a ready segmentation", stack.planes.len());
        self.held.sections = Some(stack);
        Ok(Made { staging, summary, warnings: note.warnings })
    }
}

/// The planes between two heights.
fn between(mut drawn: DrawnStack, z_mm: Option<[f64; 2]>) -> Result<DrawnStack, Error> {
    let Some([lo, hi]) = z_mm else { return Ok(drawn) };
    let ends = |d: &DrawnStack| [d.planes.first(), d.planes.last()].map(|p| p.map_or(f64::NAN, |p| p.z_mm));
    let found = ends(&drawn);
    drawn.planes.retain(|p| (lo - HEIGHT_SLACK_MM..=hi + HEIGHT_SLACK_MM).contains(&p.z_mm));
    if drawn.planes.is_empty() {
        return Err(ready::Error::OutsideZRange { found, asked: [lo, hi] }.into());
    }
    Ok(drawn)
}

/// The part of the CT around the contours.
fn around(ct: &Volume, stack: &SectionStack) -> Volume {
    let z = |plane: Option<&sections::PlaneSections>| plane.map_or(0.0, |p| p.z_mm);
    let between = ct.planes_between([z(stack.planes.first()), z(stack.planes.last())]);
    let first = between.start.min(ct.plane_z_mm.len() - 1);
    volume_file::crop(ct, lumen_bounds(stack), first..between.end.max(first + 1))
}

fn note(
    stack: &SectionStack,
    ct: Option<&Volume>,
    series: Option<SeriesMark>,
    warnings: Vec<Warning>,
) -> SegmentationNote {
    let z = |plane: Option<&sections::PlaneSections>| plane.map_or(0.0, |p| p.z_mm);
    SegmentationNote {
        window_hu: None,
        polarity: ct.map_or(Polarity::Auto, |ct| polarity(ct, stack)),
        n_planes: stack.planes.len(),
        z_mm: [z(stack.planes.first()), z(stack.planes.last())],
        n_voxels: None,
        seed_mm: Vec::new(),
        plane_windows_hu: Vec::new(),
        candidates: Vec::new(),
        series,
        warnings,
    }
}

/// Whether the image is brighter within the contours than around them: just beside them, on either side.
fn polarity(ct: &Volume, stack: &SectionStack) -> Polarity {
    let [dx, dy] = ct.pixel_spacing_xy_mm;
    let beside_mm = 1.5 * dx.max(dy);
    let mut difference = 0.0;
    for plane in &stack.planes {
        for (p, outward) in plane.contours.iter().flat_map(normals) {
            let value = |by_mm: f64| {
                let q = p + outward * by_mm;
                ct.voxel_from_stack(Point3::new(q.x, q.y, plane.z_mm))
                    .map(|[i, j, k]| f64::from(ct.at(i, j, k)))
            };
            if let (Some(within), Some(without)) = (value(-beside_mm), value(beside_mm)) {
                difference += within - without;
            }
        }
    }
    if difference < 0.0 { Polarity::Dark } else { Polarity::Bright }
}

/// Middles of the edges, and the unit normals away from the region.
fn normals(contour: &Contour) -> impl Iterator<Item = (crate::geom::Point2, Vector2)> + '_ {
    contour.edges().filter(|(a, b)| a != b).map(|(a, b)| {
        let along = (b - a).normalize();
        (a + (b - a) * 0.5, Vector2::new(along.y, -along.x))
    })
}
