//! Defects in the words of page and document.

use super::super::{Finding, Kind, Place, Report, Size, Stage, faults};
use serde::Serialize;

/// A defect as it is shown.
#[derive(Serialize)]
pub(in super::super) struct DefectRow {
    /// What it is.
    pub(in super::super) what: &'static str,
    /// The step that it arose in.
    pub(in super::super) step: &'static str,
    pub(in super::super) place: String,
    pub(in super::super) size: String,
    /// The whole in one sentence.
    pub(in super::super) text: String,
    /// Whether the replica does not pass for it.
    pub(in super::super) fails: bool,
    /// What it means for the verdict, in words.
    pub(in super::super) standing: &'static str,
    /// The plane that shows it.
    plane: Option<usize>,
}

/// Of a defect that the gate does not let pass.
pub(in super::super) const FAILS: &str = "fails";

/// All defects, those that the replica does not pass for first.
pub(super) fn rows(report: &Report) -> Vec<DefectRow> {
    let mut rows: Vec<DefectRow> = report.findings.iter().map(|f| row(f, &report.plane_z_mm)).collect();
    rows.sort_by_key(|row| !row.fails);
    rows
}

fn row(finding: &Finding, plane_z_mm: &[f64]) -> DefectRow {
    let stage = Stage::ALL.into_iter().chain([Stage::Scan]).find(|s| s.name() == finding.stage);
    DefectRow {
        what: words(finding.kind, finding.size.map_or(0.0, |s| s.size)),
        step: stage.map_or("Image", super::title),
        place: place(&finding.place),
        size: finding.size.map_or_else(|| "\u{2013}".into(), size),
        text: finding.text.clone(),
        fails: finding.beyond_gate,
        standing: match (finding.beyond_gate, finding.judged) {
            (true, true) => FAILS,
            (true, false) => "not judged: it is finer than can be told",
            (false, _) => "noted, within the limits",
        },
        plane: plane(&finding.place, plane_z_mm),
    }
}

const fn words(kind: Kind, size: f64) -> &'static str {
    match kind {
        Kind::BoundaryMoved if size < 0.0 => "Outline too far inside",
        Kind::BoundaryMoved => "Outline too far outside",
        Kind::OutlineShifted => "Outline beside its place",
        Kind::PartOff if size < 0.0 => "Part of the outline too far inside",
        Kind::PartOff => "Part of the outline too far outside",
        Kind::CalibreOff if size < 0.0 => "Lumen too narrow",
        Kind::CalibreOff => "Lumen too wide",
        Kind::Scaled if size < 0.0 => "Too small",
        Kind::Scaled => "Too large",
        Kind::Stretched if size < 0.0 => "Too low",
        Kind::Stretched => "Too high",
        Kind::Turned => "Turned",
        Kind::Mirrored => "Mirror image",
        Kind::WrongPlaneOrder => "Planes in the wrong order",
        Kind::Plugged => "Branch closed",
        Kind::IslandLost => "Island in the lumen lost",
        Kind::IslandAdded => "Island in the lumen added",
        Kind::LayerShift => "Layers shifted",
        Kind::GradualShift => "Layers shifted more and more",
        Kind::UnderExtrusion => "Too little material",
        Kind::OverExtrusion => "Too much material",
        Kind::MissingLayers => "Layers missing",
        Kind::PrintStopped => "Print stopped",
        Kind::MissingBeads => "Lines missing",
        Kind::MissingMaterial => "Material missing",
        Kind::MaterialInLumen => "Material in the lumen",
        Kind::MaterialOutside => "Material beside the part",
        Kind::MaterialInWall => "Surplus material in the wall",
        Kind::WrongHeight => "Layers at a wrong height",
        Kind::LayerThickness => "Layers too thick or too thin",
        Kind::BetweenLayers => "Material between the layers",
        Kind::Unrecognised => "Other lines than planned",
    }
}

fn place(place: &Place) -> String {
    let z = |[low, high]: [f64; 2]| {
        if (high - low).abs() < 0.005 {
            format!("z {low:.2} mm")
        } else {
            format!("z {low:.2} to {high:.2} mm")
        }
    };
    let parts = [
        place.branch.clone(),
        place.planes.map(|planes| faults::told("plane", planes)),
        place.layers.map(|layers| faults::told("layer", layers)),
        place.z_mm.map(z),
    ];
    let told: Vec<String> = parts.into_iter().flatten().collect();
    if told.is_empty() { "everywhere".into() } else { told.join(", ") }
}

fn size(Size { size, unit, uncertainty }: Size) -> String {
    match unit {
        "layers" | "planes" => {
            let unit = if size < 1.5 { unit.trim_end_matches('s') } else { unit };
            format!("{size:.0} {unit}")
        }
        "mm" => format!("{size:.3} \u{b1} {uncertainty:.3} mm"),
        "mm2" => format!("{size:.2} \u{b1} {uncertainty:.2} mm\u{b2}"),
        "mm3" => format!("{size:.3} \u{b1} {uncertainty:.3} mm\u{b3}"),
        "percent" => {
            // As many decimals as show the first digit of what is uncertain.
            let decimals = if uncertainty < 0.005 {
                3
            } else if uncertainty < 0.05 {
                2
            } else {
                1
            };
            format!("{size:.decimals$} \u{b1} {uncertainty:.decimals$} %")
        }
        other => format!("{size:.2} \u{b1} {uncertainty:.2} {other}"),
    }
}

/// The first plane of the defect, else the one nearest to its middle.
fn plane(place: &Place, plane_z_mm: &[f64]) -> Option<usize> {
    let nearest = |[low, high]: [f64; 2]| {
        let off = |k: &usize| (plane_z_mm[*k] - 0.5 * (low + high)).abs();
        (0..plane_z_mm.len()).min_by(|a, b| off(a).total_cmp(&off(b)))
    };
    place.planes.map(|planes| planes[0]).or_else(|| place.z_mm.and_then(nearest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_defect_is_told_with_its_place_its_size_and_the_plane_that_shows_it() {
        let place = Place {
            layers: Some([40, 43]),
            z_mm: Some([6.5, 7.3]),
            branch: Some("branch 2".into()),
            ..Place::default()
        };
        let finding = Finding {
            stage: "deposition",
            kind: Kind::LayerShift,
            place,
            size: Some(Size { size: 0.4, unit: "mm", uncertainty: 0.001 }),
            vector_mm: None,
            beyond_gate: true,
            judged: true,
            text: "a sentence".into(),
        };
        let row = row(&finding, &[0.0, 3.0, 6.0, 9.0]);
        assert_eq!((row.what, row.step, row.fails), ("Layers shifted", "Deposition", true));
        let standing = |beyond_gate, judged| {
            super::row(&Finding { beyond_gate, judged, ..finding.clone() }, &[0.0]).standing
        };
        assert_eq!([standing(true, true), standing(false, true)], [FAILS, "noted, within the limits"]);
        assert!(standing(true, false).starts_with("not judged"));
        let of = |stage| super::row(&Finding { stage, ..finding.clone() }, &[0.0]).step;
        assert_eq!([of("scan"), of("image")], ["Scan", "Image"]);
        assert_eq!(row.place, "branch 2, layers 40 to 43, z 6.50 to 7.30 mm");
        assert_eq!((row.size.as_str(), row.plane), ("0.400 \u{b1} 0.001 mm", Some(2)));
        let number = |size, unit| super::size(Size { size, unit, uncertainty: 0.0 });
        assert_eq!([number(1.0, "layers"), number(2.0, "planes")], ["1 layer", "2 planes"]);
        let percent = |uncertainty| size(Size { size: 2.0137, unit: "percent", uncertainty });
        assert_eq!(
            [percent(0.2), percent(0.02), percent(0.002)].map(|t| t.replace('\u{b1}', "+-")),
            ["2.0 +- 0.2 %", "2.01 +- 0.02 %", "2.014 +- 0.002 %"]
        );
        let at_planes = Place { planes: Some([1, 3]), ..Place::default() };
        assert_eq!(plane(&at_planes, &[0.0, 3.0, 6.0, 9.0]), Some(1));
        assert_eq!(
            (plane(&Place::default(), &[0.0]), super::place(&Place::default())),
            (None, "everywhere".into())
        );
    }
}
