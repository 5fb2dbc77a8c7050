//! What was changed on the way to the contours, gathered so that the operator gets one line per kind.

use crate::ct::Warning;
use crate::geom::Point3;

/// Places that a warning names: who has more to look at looks at the pictures.
const MOST_NAMED: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Fragment,
    Pinhole,
    Hole,
    Island,
    Stub,
    Detached,
    Bridged,
    Unbridged,
    Split,
    Unsplit,
    NotFitted,
    NotModelled,
    Parted,
    Sudden,
    Gap,
}

impl Kind {
    const ALL: [Self; 15] = [
        Self::Fragment,
        Self::Pinhole,
        Self::Hole,
        Self::Island,
        Self::Stub,
        Self::Detached,
        Self::Bridged,
        Self::Unbridged,
        Self::Split,
        Self::Unsplit,
        Self::NotFitted,
        Self::NotModelled,
        Self::Parted,
        Self::Sudden,
        Self::Gap,
    ];

    const fn code_and_text(self) -> (&'static str, &'static str) {
        match self {
            Self::Fragment => ("sections.fragment", "fragments of less than four pixels were dropped"),
            Self::Pinhole => ("sections.pinhole", "holes of less than four pixels were filled"),
            Self::Hole => ("sections.passing_hole", "holes that do not last three planes were filled"),
            Self::Island => ("sections.island", "islands seen in one plane only were dropped"),
            Self::Stub => ("sections.stub", "side branches seen in one plane only were dropped"),
            Self::Detached => (
                "sections.detached",
                "contours that nothing joins to the vessel of a seed were dropped (give a seed in them to keep them)",
            ),
            Self::Bridged => {
                ("sections.bridged", "contours that are one in the planes below and above were bridged")
            }
            Self::Unbridged => (
                "sections.unbridged",
                "contours that are one in the planes below and above lie too far apart for a bridge: the largest was kept",
            ),
            Self::Split => (
                "sections.split",
                "contours that are several in the planes below and above were split at the neck",
            ),
            Self::Unsplit => (
                "sections.unsplit",
                "contours that are several in the planes below and above have no neck to split at: left as one",
            ),
            Self::NotFitted => (
                "sections.not_fitted",
                "contours that show no edge in the grey values, or crossed when moved to it: the window's edge was kept there",
            ),
            Self::NotModelled => (
                "sections.not_modelled",
                "contours that no centre sees whole (crescents, two lobes), or that crossed under the model of the image: the level between lumen and wall was kept there",
            ),
            Self::Parted => (
                "sections.parted",
                "contours that the level between lumen and wall shows as one were told apart by the model of the image",
            ),
            Self::Sudden => (
                "sections.sudden_change",
                "contours that reach far beyond those below and above, as where the lumen runs into something beside it (look at them; keep what is none out with [[segment.block]] in the case file, or draw the contour with [[segment.contour]])",
            ),
            Self::Gap => ("sections.gap", "no contour was left; the vessel is interrupted there"),
        }
    }
}

/// The changes, in the order in which they were made.
#[derive(Debug, Default)]
pub(super) struct SectionWarnings(Vec<(Kind, f64, String)>);

impl SectionWarnings {
    fn area(&mut self, kind: Kind, z_mm: f64, area_mm2: f64) {
        self.0.push((kind, z_mm, format!("{area_mm2:.2} mm2")));
    }

    fn count(&mut self, kind: Kind, z_mm: f64, n: usize) {
        self.number(kind, z_mm, n, "contour");
    }

    fn number(&mut self, kind: Kind, z_mm: f64, n: usize, of: &str) {
        self.0.push((kind, z_mm, format!("{n} {of}{}", if n == 1 { "" } else { "s" })));
    }

    pub(super) fn pinholes(&mut self, z_mm: f64, n: usize) {
        self.number(Kind::Pinhole, z_mm, n, "hole");
    }

    pub(super) fn fragment(&mut self, z_mm: f64, area_mm2: f64) {
        self.area(Kind::Fragment, z_mm, area_mm2);
    }

    pub(super) fn hole(&mut self, z_mm: f64, area_mm2: f64) {
        self.area(Kind::Hole, z_mm, area_mm2);
    }

    pub(super) fn island(&mut self, z_mm: f64, area_mm2: f64) {
        self.area(Kind::Island, z_mm, area_mm2);
    }

    pub(super) fn stub(&mut self, z_mm: f64, area_mm2: f64) {
        self.area(Kind::Stub, z_mm, area_mm2);
    }

    pub(super) fn detached(&mut self, z_mm: f64, area_mm2: f64) {
        self.area(Kind::Detached, z_mm, area_mm2);
    }

    pub(super) fn bridged(&mut self, z_mm: f64, n: usize) {
        self.count(Kind::Bridged, z_mm, n);
    }

    pub(super) fn unbridged(&mut self, z_mm: f64, n: usize) {
        self.count(Kind::Unbridged, z_mm, n);
    }

    pub(super) fn split(&mut self, z_mm: f64, n: usize) {
        self.count(Kind::Split, z_mm, n);
    }

    pub(super) fn unsplit(&mut self, z_mm: f64, n: usize) {
        self.count(Kind::Unsplit, z_mm, n);
    }

    pub(super) fn not_fitted(&mut self, z_mm: f64, n: usize) {
        self.count(Kind::NotFitted, z_mm, n);
    }

    pub(super) fn not_modelled(&mut self, z_mm: f64, n: usize) {
        self.count(Kind::NotModelled, z_mm, n);
    }

    pub(super) fn parted(&mut self, z_mm: f64, n: usize) {
        self.count(Kind::Parted, z_mm, n);
    }

    /// How far, mm, and where (LPS).
    pub(super) fn sudden(&mut self, z_mm: f64, reach_mm: f64, at: Point3) {
        let what = format!("{reach_mm:.2} mm, at ({:.3}, {:.3}, {:.3})", at.x, at.y, at.z);
        self.0.push((Kind::Sudden, z_mm, what));
    }

    pub(super) fn gap(&mut self, z_mm: f64) {
        self.count(Kind::Gap, z_mm, 0);
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// How many changes of each kind there are, by their codes.
    #[cfg(test)]
    pub(super) fn counts(&self) -> std::collections::BTreeMap<&'static str, usize> {
        self.0.iter().fold(Default::default(), |mut counts, (kind, ..)| {
            *counts.entry(kind.code_and_text().0).or_default() += 1;
            counts
        })
    }

    /// One warning per kind, naming the first places.
    pub(super) fn into_warnings(self) -> Vec<Warning> {
        let of_kind = |kind: Kind| {
            let places: Vec<String> = self
                .0
                .iter()
                .filter(|(k, ..)| *k == kind)
                .map(|(_, z_mm, what)| format!("z {z_mm:.3} mm ({what})"))
                .collect();
            let (code, text) = kind.code_and_text();
            let named = places.len().min(MOST_NAMED);
            let more = match places.len() - named {
                0 => String::new(),
                n => format!(", and {n} more"),
            };
            let text = format!("{text}: {}{more}", places[..named].join(", "));
            (!places.is_empty()).then(|| Warning { code: code.into(), text })
        };
        Kind::ALL.into_iter().filter_map(of_kind).collect()
    }
}
