//! A report to its page: one HTML document that holds everything it shows and refers to nothing outside.
//!
//! The planes are vector graphics over the pixels of the CT, which need no script; the viewer takes them from there. All
//! text goes through the template engine's HTML escaping.

use super::plate::{Grey, UNITS_PER_MM};
use super::{BodyKind, Error, Figures, INTENDED_USE, NOT_SEEN, Origin, Report, Stage, methods, shown};
use minijinja::{AutoEscape, Environment};
use rayon::prelude::*;
use serde::Serialize;
use tables::narrow;

pub(super) mod chart;
mod colour;
pub(super) mod defects;
mod embed;
mod spread;
pub(super) mod tables;
mod unrolled;

pub(super) use unrolled::Map;

/// Most bytes of all grey pictures together; beyond, they are shown with half as many pixels each way.
const GREY_BYTES_MOST: usize = 7_000_000;

#[derive(Serialize)]
pub(super) struct View {
    pub(super) style: &'static str,
    pub(super) viewer: &'static str,
    pub(super) model_view: &'static str,
    pub(super) body_text: &'static str,
    pub(super) has_ct: bool,
    pub(super) has_scan: bool,
    pub(super) n_planes: usize,
    pub(super) n_layers: usize,
    /// What this is a report of: name and value.
    pub(super) about: Vec<(&'static str, String)>,
    /// The same in a line, letters and digits alone: nothing in it ends a style sheet.
    pub(super) running: String,
    /// What all that the print has laid is called, and how it is known.
    pub(super) deposited: &'static str,
    pub(super) known: &'static str,
    pub(super) passed: bool,
    /// Whether the part was watched or scanned.
    pub(super) is_measured: bool,
    /// Whether what is called deposited is only what was commanded.
    pub(super) is_commanded: bool,
    pub(super) verdict: String,
    /// Limits that are not kept, and defects beyond them.
    pub(super) failures: Vec<String>,
    /// Those that cannot be judged.
    pub(super) not_judged: Vec<String>,
    pub(super) defects: Vec<defects::DefectRow>,
    pub(super) not_seen: [&'static str; NOT_SEEN.len()],
    pub(super) cards: Vec<Card>,
    pub(super) notes: Vec<Note>,
    pub(super) stages: Vec<StageRow>,
    pub(super) charts: Vec<chart::Chart>,
    window: Option<Window>,
    /// JSON of numbers, letters and base64: nothing in it ends a script.
    pub(super) view_data: String,
    pub(super) model_data: Option<String>,
    pub(super) map_groups: Vec<MapGroup>,
    pub(super) most_mm: f64,
    pub(super) sides: [&'static str; 6],
    pub(super) planes: Vec<PlaneView>,
    pub(super) tables: Vec<tables::Table>,
    pub(super) methods: Vec<Method>,
    pub(super) intended_use: &'static str,
}

/// Maps of one comparison.
#[derive(Serialize)]
pub(super) struct MapGroup {
    /// What is compared, where there are several.
    pub(super) title: Option<String>,
    pub(super) maps: Vec<Map>,
}

#[derive(Serialize)]
pub(super) struct Card {
    pub(super) label: String,
    pub(super) value: String,
    pub(super) hint: String,
}

/// A note as it is shown: a sentence, and what it lists.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Note {
    pub(super) code: String,
    pub(super) lead: String,
    pub(super) items: Vec<String>,
}

impl Note {
    /// Texts longer than this that list things are taken apart, letters.
    const LONG: usize = 160;

    fn of(note: &crate::ct::Warning) -> Self {
        let listed = note.text.split_once(": ").filter(|_| note.text.len() > Self::LONG);
        let parts =
            listed.map(|(lead, list)| (lead, list.split("; ").map(str::to_owned).collect::<Vec<_>>()));
        let (lead, items) = match parts {
            Some((lead, items)) if items.len() > 2 => (format!("{lead}:"), items),
            _ => (note.text.clone(), Vec::new()),
        };
        let mut letters = lead.chars();
        let first = letters.next().map(char::to_uppercase);
        let lead = first.into_iter().flatten().chain(letters).collect();
        Self { code: note.code.clone(), lead, items }
    }
}

#[derive(Serialize)]
pub(super) struct Method {
    pub(super) name: &'static str,
    pub(super) text: &'static str,
}

#[derive(Serialize)]
pub(super) struct StageRow {
    pub(super) name: &'static str,
    pub(super) meaning: &'static str,
    pub(super) reason: Option<String>,
    pub(super) mean: String,
    pub(super) rms: String,
    pub(super) p95: String,
    pub(super) max: String,
    pub(super) bias: String,
    pub(super) dice: String,
    pub(super) area: String,
}

/// What the viewer needs beside the pictures.
#[derive(Serialize)]
struct ViewData {
    sides: [&'static str; 6],
    range_hu: Option<[f64; 2]>,
    window_hu: Option<[f64; 2]>,
}

/// From the bytes of grey pictures to what is shown of them.
#[derive(Serialize)]
struct Window {
    range_hu: [f64; 2],
    window_hu: [f64; 2],
    slope: f64,
    intercept: f64,
}

impl Window {
    fn of(grey: &Grey) -> Self {
        let ([low, high], [black, white]) = (grey.range_hu, grey.window_hu);
        let slope = (high - low) / (white - black);
        Self {
            range_hu: grey.range_hu,
            window_hu: grey.window_hu,
            slope,
            intercept: (low - black) / (white - black),
        }
    }
}

/// A plane's lines as paths and its pixels as an address.
#[derive(Serialize)]
struct PlateView {
    width: i32,
    height: i32,
    grey: Option<GreyView>,
    material: String,
    paths: String,
    solid: String,
    contours: String,
    scan: String,
    bar: Bar,
}

#[derive(Serialize)]
struct GreyView {
    address: String,
    place: [f64; 4],
}

/// The bar that shows a length.
#[derive(Serialize)]
pub(super) struct Bar {
    pub(super) x0: f64,
    pub(super) x1: f64,
    pub(super) y: f64,
    pub(super) text: String,
    pub(super) letter: f64,
}

impl Bar {
    /// Of a round length, about a fifth of the picture.
    pub(super) fn of([width, height]: [i32; 2]) -> Self {
        let most_mm = 0.25 * f64::from(width) / UNITS_PER_MM;
        let mm = [100.0, 50.0, 20.0, 10.0, 5.0, 2.0].into_iter().find(|l| *l <= most_mm).unwrap_or(1.0);
        let letter = 0.04 * f64::from(width.max(height));
        let x0 = 0.7 * letter;
        let y = f64::from(height) - 0.7 * letter;
        Self { x0, x1: x0 + mm * UNITS_PER_MM, y, text: format!("{mm} mm"), letter }
    }
}

#[derive(Serialize)]
pub(super) struct PlaneView {
    pub(super) plane: usize,
    pub(super) z: String,
    pub(super) layer: Option<String>,
    pub(super) alt: String,
    plate: PlateView,
    pub(super) figures: Vec<Labelled>,
    pub(super) cells: Vec<String>,
}

#[derive(Serialize)]
pub(super) struct Labelled {
    label: String,
    value: String,
}

/// The page.
///
/// # Errors
/// [`Error::Page`] where the template cannot be rendered, [`Error::Drawing`] where a picture cannot be encoded.
pub fn html(report: &Report) -> Result<String, Error> {
    render(&view(report)?)
}

pub(super) fn render(view: &View) -> Result<String, Error> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.add_template("index.html", include_str!("index.html"))?;
    Ok(environment.get_template("index.html")?.render(minijinja::value::Serde(view))?)
}

/// What page and document say.
pub(super) fn view(report: &Report) -> Result<View, Error> {
    let rings = report.pictures.iter().flat_map(|p| p.plate.ring.iter().chain(&p.plate.scan_ring));
    let range = colour::Range::of(rings);
    let greys = greys(report)?;
    let plates = report.pictures.iter().zip(greys);
    let window = report.pictures.iter().find_map(|p| p.plate.grey.as_ref()).map(Window::of);
    let sides = report.pictures.first().map_or([""; 6], |p| p.plate.sides);
    Ok(View {
        style: include_str!("page/style.css"),
        viewer: include_str!("page/viewer.js"),
        model_view: include_str!("page/model.js"),
        body_text: match report.body {
            BodyKind::Wall => "Hollow replica: a wall around the open lumen.",
            BodyKind::Cast => "Solid replica: a cast of the lumen.",
        },
        has_ct: report.block(Stage::Total).reason.is_none(),
        has_scan: report.scan.is_some(),
        n_planes: report.plane_z_mm.len(),
        n_layers: report.layers.len(),
        about: report.about.rows(),
        running: report.about.running(),
        deposited: report.origin.word(),
        known: report.origin.known(),
        passed: report.verdict.passed,
        is_measured: report.verdict.is_measured(),
        is_commanded: report.origin == Origin::Commanded,
        verdict: if report.verdict.passed {
            report.verdict.sentence()
        } else {
            report.verdict.refusal().into()
        },
        failures: report.verdict.failures.clone(),
        not_judged: report.verdict.not_judged.clone(),
        defects: defects::rows(report),
        not_seen: NOT_SEEN,
        cards: cards(report),
        notes: report.notes.iter().map(Note::of).collect(),
        stages: report.stages().map(|stage| stage_row(report, stage)).collect(),
        charts: chart::all(report),
        view_data: serde_json::to_string(&ViewData {
            sides,
            range_hu: window.as_ref().map(|w| w.range_hu),
            window_hu: window.as_ref().map(|w| w.window_hu),
        })?,
        model_data: embed::Model::of(&report.surface, range.most_mm, report.scan.is_some())
            .map(|model| serde_json::to_string(&model))
            .transpose()?,
        window,
        map_groups: map_groups(report, range)?,
        most_mm: range.most_mm,
        sides,
        planes: plates.map(|(p, grey)| plane_view(report, p, grey)).collect(),
        tables: tables::all(report),
        methods: methods::METHODS.map(|(name, text)| Method { name, text }).into(),
        intended_use: INTENDED_USE,
    })
}

/// The maps of what was deposited, and of a scan.
fn map_groups(report: &Report, range: colour::Range) -> Result<Vec<MapGroup>, png::EncodingError> {
    let deposited = unrolled::maps(report, range, |p| &p.ring)?;
    if report.scan.is_none() {
        return Ok(vec![MapGroup { title: None, maps: deposited }]);
    }
    let scanned = unrolled::maps(report, range, |p| &p.scan_ring)?;
    let groups = [
        (format!("The lumen {} against the image", report.origin.known()), deposited),
        ("The scanned lumen against the solid".into(), scanned),
    ];
    Ok(groups.into_iter().map(|(title, maps)| MapGroup { title: Some(title), maps }).collect())
}

/// The grey pictures, as fine as the page may hold.
fn greys(report: &Report) -> Result<Vec<Option<GreyView>>, png::EncodingError> {
    let mut greys: Vec<Option<Grey>> = report.pictures.iter().map(|p| p.plate.grey.clone()).collect();
    let views = loop {
        let encode = |grey: &Option<Grey>| grey.as_ref().map(Grey::png).transpose();
        let files: Vec<Option<Vec<u8>>> = greys.par_iter().map(encode).collect::<Result<_, _>>()?;
        if files.iter().flatten().map(Vec::len).sum::<usize>() <= GREY_BYTES_MOST {
            let view = |(grey, file): (&Option<Grey>, &Option<Vec<u8>>)| {
                Some(GreyView {
                    place: grey.as_ref()?.place.map(|v| (v * 100.0).round() / 100.0),
                    address: embed::png(file.as_ref()?),
                })
            };
            break greys.iter().zip(&files).map(view).collect();
        }
        greys.iter_mut().flatten().for_each(|grey| *grey = grey.halved());
    };
    Ok(views)
}

fn plate_view(plate: &super::plate::Plate, grey: Option<GreyView>) -> PlateView {
    PlateView {
        width: plate.size[0],
        height: plate.size[1],
        grey,
        material: embed::path(&plate.material, true),
        paths: embed::path(&plate.paths, false),
        solid: embed::path(&plate.solid, true),
        contours: embed::path(&plate.contours, true),
        scan: embed::path(&plate.scan, true),
        bar: Bar::of(plate.size),
    }
}

fn mm(value: Option<f64>) -> String {
    shown(value, 3)
}

fn with_unit(value: Option<f64>) -> String {
    if value.is_some() { format!("{} mm", mm(value)) } else { "not known".into() }
}

/// What is uncertain of a card's figure.
fn off(uncertainty: Option<f64>, decimals: usize, unit: &str) -> String {
    uncertainty.map_or_else(String::new, |u| format!("\u{b1} {u:.decimals$}{unit}; "))
}

fn cards(report: &Report) -> Vec<Card> {
    let total = report.block(Stage::Total).overall.unwrap_or_default();
    let deposition = report.block(Stage::Deposition).overall.unwrap_or_default();
    let (f, u) = (total.figures, total.figures.uncertainty);
    let dice = f.dice.map_or_else(|| "not known".into(), |d| format!("{d:.4}"));
    let compared = match report.origin {
        Origin::Recorded => "image against deposited lumen",
        Origin::Commanded => "image against commanded lumen, not measured",
    };
    let layers = match report.origin {
        Origin::Recorded => "deposited against planned material",
        Origin::Commanded => "commanded against planned material, not measured",
    };
    let card = |label: &str, value: String, hint: String| Card { label: label.into(), value, hint };
    let mut cards = vec![
        card("Total error, mean", with_unit(f.mean_mm), off(u.mean_mm, 3, " mm") + compared),
        card("Total error, 95th percentile", with_unit(f.p95_mm), off(u.p95_mm, 3, " mm") + compared),
        card(
            "Total error, bias",
            with_unit(f.bias_mm),
            off(u.bias_mm, 3, " mm") + "positive: the lumen is too wide",
        ),
        card("Overlap (Dice)", dice, off(u.dice, 4, "") + "1 is identical"),
        card("Worst layer (IoU)", shown(deposition.iou_min, 4), layers.into()),
    ];
    if let Some(scan) = report.scan.as_ref().and_then(|s| s.block.overall) {
        let (f, u) = (scan.figures, scan.figures.uncertainty);
        let hint = off(u.p95_mm, 3, " mm") + "solid against scanned replica";
        cards.push(card("Scan, 95th percentile", with_unit(f.p95_mm), hint));
    }
    cards
}

fn stage_row(report: &Report, stage: Stage) -> StageRow {
    let block = report.block(stage);
    let f = block.overall.unwrap_or_default().figures;
    let u = f.uncertainty;
    StageRow {
        name: title(stage),
        meaning: report.meaning(stage),
        reason: block.reason.clone(),
        mean: narrow(f.mean_mm, u.mean_mm, 3),
        rms: narrow(f.rms_mm, u.rms_mm, 3),
        p95: narrow(f.p95_mm, u.p95_mm, 3),
        max: narrow(f.max_mm, u.max_mm, 3),
        bias: narrow(f.bias_mm, u.bias_mm, 3),
        dice: narrow(f.dice, u.dice, 4),
        area: narrow(f.area_error_percent, u.area_error_percent, 2),
    }
}

const fn title(stage: Stage) -> &'static str {
    match stage {
        Stage::Segmentation => "Segmentation",
        Stage::Reconstruction => "Reconstruction",
        Stage::Slicing => "Slicing",
        Stage::Toolpath => "Toolpath",
        Stage::Deposition => "Deposition",
        Stage::Total => "Total",
        Stage::Scan => "Scan",
    }
}

fn plane_view(report: &Report, picture: &super::Picture, grey: Option<GreyView>) -> PlaneView {
    let k = picture.plane;
    let z_mm = report.plane_z_mm[k];
    let layer = report.layers.iter().find(|l| l.ct_plane == Some(k)).map(|l| l.layer.to_string());
    let of = |stage: Stage| -> Figures {
        report.block(stage).planes.get(k).map(|p| p.figures).unwrap_or_default()
    };
    let total = of(Stage::Total);
    let iou = report.block(Stage::Deposition).planes.get(k).and_then(|p| p.iou);
    let mut cells: Vec<String> = [total.mean_mm, total.p95_mm, total.max_mm, total.bias_mm].map(mm).into();
    cells.push(shown(total.dice, 4));
    cells.push(shown(total.area_error_percent, 2));
    cells.extend(Stage::ALL[..5].iter().map(|&stage| mm(of(stage).mean_mm)));
    cells.push(shown(iou, 4));
    cells.extend(report.scan.as_ref().map(|_| mm(of(Stage::Scan).mean_mm)));
    let mut figures: Vec<Labelled> = report
        .stages()
        .map(|stage| Labelled {
            label: format!("{}, mean", title(stage)),
            value: figure_or_reason(report, stage, k),
        })
        .collect();
    figures.push(Labelled { label: "Total, 95th percentile".into(), value: with_unit(total.p95_mm) });
    figures.push(Labelled { label: "Total, bias".into(), value: with_unit(total.bias_mm) });
    figures.push(Labelled { label: "Material overlap (IoU)".into(), value: shown(iou, 4) });
    PlaneView {
        plane: k,
        z: format!("{z_mm:.2}"),
        layer,
        alt: alt(report, k, &total),
        plate: plate_view(&picture.plate, grey),
        figures,
        cells,
    }
}

impl PlaneView {
    /// Which plane it is.
    pub(super) fn name(&self) -> String {
        let layer = self.layer.as_ref().map_or_else(String::new, |l| format!(", layer {l}"));
        format!("CT plane {}, z {} mm{layer}", self.plane, self.z)
    }

    /// The total error in a line.
    pub(super) fn summary(&self) -> String {
        match self.cells.as_slice() {
            [mean, p95, _, bias, ..] => format!("total: mean {mean}, 95th percentile {p95}, bias {bias} mm"),
            _ => String::new(),
        }
    }
}

fn figure_or_reason(report: &Report, stage: Stage, k: usize) -> String {
    match report.block(stage).planes.get(k) {
        Some(p) if p.figures.mean_mm.is_some() => with_unit(p.figures.mean_mm),
        Some(p) => p.reason.clone().unwrap_or_else(|| "not known".into()),
        None => "not known".into(),
    }
}

fn alt(report: &Report, plane: usize, total: &Figures) -> String {
    let (z_mm, word) = (report.plane_z_mm[plane], report.origin.word());
    let figures = match (total.mean_mm, total.p95_mm) {
        (Some(mean), Some(p95)) => {
            format!(
                "{word} lumen is off the image by {mean:.3} mm on average, {p95:.3} mm at the 95th percentile"
            )
        }
        _ => "the total error of this plane is not known".into(),
    };
    format!(
        "CT plane {plane} at z {z_mm:.2} mm with segmented boundary, section of the solid, toolpaths and {word} material; {figures}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ct::Warning;

    #[test]
    fn a_note_that_lists_places_is_a_list() {
        let place =
            "plane 12 (z 34.500 mm) at R 12.3 mm, A 4.5 mm, H 678.9 mm into something bright, 3.4 mm wide";
        let text =
            format!("the region was cut off where it left the vessel: {place}; {place}; and 2 narrower ones");
        let note = Note::of(&Warning::new("segment.leak_cut", text));
        assert_eq!(note.lead, "The region was cut off where it left the vessel:");
        assert_eq!(note.items, [place, place, "and 2 narrower ones"]);
        let short = Note::of(&Warning::new("x", "one: two; three; four"));
        assert_eq!((short.lead.as_str(), short.items.len()), ("One: two; three; four", 0));
    }
}
