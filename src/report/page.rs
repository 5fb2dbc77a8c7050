//! A report to its page: one HTML document without any reference to the network; the pictures lie beside it.
//!
//! All text goes through the template engine's HTML escaping.

use super::{BodyKind, Figures, INTENDED_USE, Report, Stage, shown};
use minijinja::{AutoEscape, Environment};
use serde::Serialize;

mod chart;

/// How the figures came about: name and text.
pub(super) const METHODS: [(&str, &str); 6] = [
    (
        "Distances",
        "Each outline is walked in steps of 0.05 mm and the exact distance to the other one is taken, both ways, pooled. Sampling errs by less than 0.001 mm on the mean; the maximum may miss a corner by 0.025 mm.",
    ),
    (
        "Boundary in the image",
        "Half-way between the grey levels inside and outside, along the normal of the contour, linear between pixels, averaged over about a pixel along the contour; found from the grey values alone. Behind a wall hardly thicker than the blur, the wall's own level is found from all profiles of the contour together. Blur draws the half-way point of a curved boundary inward by s\u{b2}k/2; this is measured (blur s from the steepness of the edge, curvature k from the contour) and undone. Where no clear edge exists, the place is left out.",
    ),
    (
        "Beads",
        "Strokes of their width with round joints and ends, united per layer. The lumen of a hollow wall is what the beads enclose and leave open; that of a cast is what they cover, with the pores between them.",
    ),
    (
        "Registration",
        "Image, solid and job stay where the job was planned; nothing is fitted to the recorded material. The planned geometry was checked to lie within 0.01 mm of the layers. Recorded pieces belong to the layer at whose height they were deposited.",
    ),
    (
        "Areas and Dice",
        "Boolean operations on polygons on a grid of 10 nm. Dice is twice the common area over the sum of both areas; IoU the common over the united area; both are 1 for identical areas.",
    ),
    (
        "Diameters and stenosis",
        "In the CT plane. Equivalent: of the circle of the same area. Minimum: least distance between parallel lines that enclose the lumen. NASCET: 1 - narrowest / first normal segment beyond (5 mm or more, within 5 % of its mean), minimum diameters.",
    ),
];

#[derive(Serialize)]
struct View {
    body_text: &'static str,
    has_ct: bool,
    n_planes: usize,
    n_layers: usize,
    passed: bool,
    verdict: String,
    cards: Vec<Card>,
    notes: Vec<crate::ct::Warning>,
    stages: Vec<StageRow>,
    charts: Vec<chart::Chart>,
    planes: Vec<PlaneView>,
    anatomy: Vec<AnatomyRow>,
    methods: Vec<Method>,
    intended_use: &'static str,
}

#[derive(Serialize)]
struct Card {
    label: &'static str,
    value: String,
    hint: &'static str,
}

#[derive(Serialize)]
struct Method {
    name: &'static str,
    text: &'static str,
}

#[derive(Serialize)]
struct StageRow {
    name: &'static str,
    meaning: &'static str,
    reason: Option<String>,
    mean: String,
    rms: String,
    p95: String,
    max: String,
    bias: String,
    dice: String,
    area: String,
}

#[derive(Serialize)]
struct PlaneView {
    plane: usize,
    z: String,
    layer: Option<String>,
    file: String,
    alt: String,
    width: u32,
    height: u32,
    figures: Vec<Labelled>,
    cells: Vec<String>,
}

#[derive(Serialize)]
struct Labelled {
    label: String,
    value: String,
}

#[derive(Serialize)]
struct AnatomyRow {
    branch: String,
    planes: String,
    stage: &'static str,
    area: String,
    equivalent: String,
    minimum: String,
    stenosis: String,
}

/// The page.
///
/// # Errors
/// Where the template cannot be rendered.
pub fn html(report: &Report) -> Result<String, minijinja::Error> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.add_template("index.html", include_str!("index.html"))?;
    environment.get_template("index.html")?.render(minijinja::value::Serde(view(report)))
}

fn view(report: &Report) -> View {
    View {
        body_text: match report.body {
            BodyKind::Wall => "Hollow replica: a wall around the open lumen.",
            BodyKind::Cast => "Solid replica: a cast of the lumen.",
        },
        has_ct: report.block(Stage::Total).reason.is_none(),
        n_planes: report.plane_z_mm.len(),
        n_layers: report.layers.len(),
        passed: report.verdict.passed,
        verdict: report.verdict.sentence(),
        cards: cards(report),
        notes: report.notes.clone(),
        stages: Stage::ALL.into_iter().map(|stage| stage_row(report, stage)).collect(),
        charts: chart::all(report),
        planes: report.pictures.iter().map(|p| plane_view(report, p)).collect(),
        anatomy: anatomy_rows(report),
        methods: METHODS.map(|(name, text)| Method { name, text }).into(),
        intended_use: INTENDED_USE,
    }
}

fn mm(value: Option<f64>) -> String {
    shown(value, 3)
}

fn with_unit(value: Option<f64>) -> String {
    if value.is_some() { format!("{} mm", mm(value)) } else { "not known".into() }
}

fn cards(report: &Report) -> Vec<Card> {
    let total = report.block(Stage::Total).overall.unwrap_or_default();
    let deposition = report.block(Stage::Deposition).overall.unwrap_or_default();
    let dice = total.figures.dice.map_or_else(|| "not known".into(), |d| format!("{d:.4}"));
    vec![
        Card {
            label: "Total error, mean",
            value: with_unit(total.figures.mean_mm),
            hint: "image against deposited lumen",
        },
        Card {
            label: "95 % lie within",
            value: with_unit(total.figures.p95_mm),
            hint: "image against deposited lumen",
        },
        Card {
            label: "Bias",
            value: with_unit(total.figures.bias_mm),
            hint: "positive: the replica's lumen is too wide",
        },
        Card { label: "Overlap (Dice)", value: dice, hint: "1 is identical" },
        Card {
            label: "Worst layer (IoU)",
            value: shown(deposition.iou_min, 4),
            hint: "deposited against planned material",
        },
    ]
}

fn stage_row(report: &Report, stage: Stage) -> StageRow {
    let block = report.block(stage);
    let f = block.overall.unwrap_or_default().figures;
    StageRow {
        name: title(stage),
        meaning: stage.meaning(),
        reason: block.reason.clone(),
        mean: mm(f.mean_mm),
        rms: mm(f.rms_mm),
        p95: mm(f.p95_mm),
        max: mm(f.max_mm),
        bias: mm(f.bias_mm),
        dice: shown(f.dice, 4),
        area: shown(f.area_error_percent, 2),
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
    }
}

fn plane_view(report: &Report, picture: &super::Picture) -> PlaneView {
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
    let mut figures: Vec<Labelled> = Stage::ALL
        .into_iter()
        .map(|stage| Labelled {
            label: format!("{}, mean", title(stage)),
            value: figure_or_reason(report, stage, k),
        })
        .collect();
    figures.push(Labelled { label: "Total, 95 %".into(), value: with_unit(total.p95_mm) });
    figures.push(Labelled { label: "Total, bias".into(), value: with_unit(total.bias_mm) });
    figures.push(Labelled { label: "Material overlap (IoU)".into(), value: shown(iou, 4) });
    PlaneView {
        plane: k,
        z: format!("{z_mm:.2}"),
        layer,
        file: picture.file_name(),
        alt: alt(k, z_mm, &total),
        width: picture.size_px[0],
        height: picture.size_px[1],
        figures,
        cells,
    }
}

fn figure_or_reason(report: &Report, stage: Stage, k: usize) -> String {
    match report.block(stage).planes.get(k) {
        Some(p) if p.figures.mean_mm.is_some() => with_unit(p.figures.mean_mm),
        Some(p) => p.reason.clone().unwrap_or_else(|| "not known".into()),
        None => "not known".into(),
    }
}

fn alt(plane: usize, z_mm: f64, total: &Figures) -> String {
    let figures = match (total.mean_mm, total.p95_mm) {
        (Some(mean), Some(p95)) => {
            format!("deposited lumen is off the image by {mean:.3} mm on average, {p95:.3} mm at 95 %")
        }
        _ => "the total error of this plane is not known".into(),
    };
    format!(
        "CT plane {plane} at z {z_mm:.2} mm with segmented boundary, section of the solid, toolpaths and deposited material; {figures}"
    )
}

fn anatomy_rows(report: &Report) -> Vec<AnatomyRow> {
    let rows = report.anatomy.branches.iter().flat_map(|branch| {
        branch.stages.iter().map(move |stage| AnatomyRow {
            branch: branch.name.clone(),
            planes: format!("{} to {}", branch.planes[0], branch.planes[1]),
            stage: stage.stage,
            area: shown(stage.lumen_area_mm2, 2),
            equivalent: shown(stage.equivalent_diameter_mm, 2),
            minimum: shown(stage.minimum_diameter_mm, 2),
            stenosis: stenosis(&stage.stenosis),
        })
    });
    rows.collect()
}

fn stenosis(s: &super::Stenosis) -> String {
    match (s.stenosis_nascet_percent, s.stenosis_throat, s.stenosis_reference) {
        (Some(percent), Some(throat), Some(reference)) => format!(
            "{percent:.0} % (throat {:.2} mm at plane {}, reference {:.2} mm at planes {} to {})",
            throat.diameter_mm, throat.plane, reference.diameter_mm, reference.planes[0], reference.planes[1]
        ),
        _ => s.stenosis_reason.clone().unwrap_or_default(),
    }
}
