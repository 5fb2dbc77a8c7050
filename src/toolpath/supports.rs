//! What holds material up that would be printed in the air: columns that stand under it and break away.
//!
//! Material of a layer that lies farther outside the layer below than the profile's overhang reaches (its height times the
//! tangent of the angle from the vertical) is to be held up. It is followed downward: a column ends on the bed, or on the
//! part. Between column and part there is air, beside and above it (and below, where it stands on the part), so that it comes
//! off; its uppermost layers are dense. An outline goes around each column, sparse lines fill it; where it would stand on less than
//! [`NARROWEST_COLUMN_MM`] it is made as wide from the bed up, as far as the part leaves room. The lumen counts as held up by itself unless the profile wants it otherwise: no
//! column stands or passes in it. Where the profile wants columns that stand on the bed alone, those over the part are left out:
//! of another program's model the lumen is known only where a layer shows it as a hole.
//!
//! Not done: trees; columns are as large as what they hold up. Between parts that leave less room than a bead nothing stands. Cost: a few boolean operations a layer, from the top downward.

use super::fill::{FillParams, Path, Role, Vertex};
use super::{BeadKind, raster, simplify};
use crate::geom::{Point2, Region};
use crate::profile::{Profile, SupportStyle};
use crate::slice::Layer;
use std::collections::VecDeque;

/// Chord tolerance of columns, mm: they are no part of the print.
const TOLERANCE_MM: f64 = 0.02;
/// Narrower overhangs than this are noise of the layers' outlines, mm.
const NARROWEST_MM: f64 = 0.02;
/// So far what is held up of one layer laps over that of the layer below on a slope, mm: strips that only touch leave slits between
/// them, and columns fall into crumbs.
const LAP_MM: f64 = 0.05;
/// Layers of air between a column and what it holds up.
pub(super) const AIR_LAYERS: usize = 1;
/// Dense layers at a column's top.
const INTERFACE_LAYERS: usize = 2;
/// Fill of these, percent.
const INTERFACE_PERCENT: f64 = 75.0;
/// Columns on the bed are at least so wide, mm: narrower ones topple.
const NARROWEST_COLUMN_MM: f64 = 1.2;
/// What rounding takes from a right-angled corner is no narrow column: the share of the square of half of that width.
const CORNER: f64 = 0.3;
/// Shorter outlines are specks that hold nothing, mm.
const SHORTEST_LOOP_MM: f64 = 1.5;
/// Least fill of the lowest layer, percent: it has to hold on to the bed.
const FIRST_LAYER_PERCENT: f64 = 50.0;

/// A layer of the part, as far as supports go.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slab<'a> {
    pub(super) material: &'a Region,
    pub(super) lumen: &'a Region,
    pub(super) height_mm: f64,
}

/// The columns in one layer.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Support {
    /// Sparse.
    pub(super) body: Region,
    /// Dense, just below what is held up.
    pub(super) interface: Region,
}

impl<'a> Slab<'a> {
    pub(super) const fn of(layer: &Layer, placed: &'a (Region, Region)) -> Self {
        Self { material: &placed.0, lumen: &placed.1, height_mm: layer.slot.height_mm }
    }

    /// Where no column may be.
    fn filled(&self, profile: &Profile) -> Region {
        if profile.print.support_in_lumen { self.material.clone() } else { self.material.union(self.lumen) }
    }
}

impl Support {
    fn is_empty(&self) -> bool {
        self.body.is_empty() && self.interface.is_empty()
    }

    /// Takes away what lies in a region.
    pub(super) fn leave_out(&mut self, region: &Region) {
        self.body = self.body.difference(region);
        self.interface = self.interface.difference(region);
    }

    /// Where there is any.
    pub(super) fn area(&self) -> Region {
        self.body.union(&self.interface)
    }

    /// The lines of a layer, body first.
    pub(super) fn paths(&self, layer: usize, params: &FillParams, profile: &Profile) -> Vec<Path> {
        let percent = profile.print.support_percent;
        let percent = if layer == 0 { percent.max(FIRST_LAYER_PERCENT) } else { percent };
        let lines = |region: &Region, percent: f64, angle_deg: f64, kind: BeadKind| {
            let paths = raster::raster(region, params, percent, angle_deg.to_radians());
            paths.into_iter().map(move |path| Path { kind, ..path })
        };
        // Sparse lines stand on each other; dense ones lie across them.
        let inside = self.body.offset(-params.pitch_mm(), TOLERANCE_MM);
        let body = lines(&inside, percent, 0.0, BeadKind::SupportMaterial);
        outlines(&self.body, params)
            .chain(body)
            .chain(lines(&self.interface, INTERFACE_PERCENT, 90.0, BeadKind::SupportInterface))
            .collect()
    }
}

/// A bead along the border of each column, however narrow: sparse lines alone would miss some.
fn outlines(body: &Region, params: &FillParams) -> impl Iterator<Item = Path> {
    let width_mm = params.width_mm;
    let within = body.offset(-width_mm / 2.0, TOLERANCE_MM);
    let long = within.contours.into_iter().filter(|c| c.perimeter_mm() >= SHORTEST_LOOP_MM);
    long.map(move |contour| {
        let contour = simplify::contour(&contour, TOLERANCE_MM);
        let vertices = contour.points.iter().map(|&at| Vertex { at, width_mm, room_mm: 0.0 }).collect();
        Path { kind: BeadKind::SupportMaterial, role: Role::Outer, closed: true, vertices }
    })
}

/// The columns in every layer, from the bed upward.
pub(super) fn columns(slabs: &[Slab<'_>], profile: &Profile) -> Vec<Support> {
    let mut supports = vec![Support::default(); slabs.len()];
    if profile.print.support == SupportStyle::None {
        return supports;
    }
    let filled = |slab: &Slab<'_>| slab.filled(profile);
    // What the layers above have to be held up, the nearest first: air, then the dense layers.
    let mut fresh: VecDeque<Region> = VecDeque::new();
    let mut carried = Region::default();
    let mut above = Region::default();
    for idx in (0..slabs.len()).rev() {
        let here = filled(&slabs[idx]);
        if fresh.len() > AIR_LAYERS + INTERFACE_LAYERS {
            fresh.pop_back();
        }
        if let Some(held) = fresh.get(AIR_LAYERS).filter(|r| !r.is_empty()) {
            carried = carried.union(held);
        }
        if !carried.is_empty() {
            // What stands on the part goes no further down.
            carried = carried.difference(&here);
            supports[idx] =
                cut(&carried, &here, &above, idx.checked_sub(1).map(|i| filled(&slabs[i])), &fresh, profile);
        }
        let overhang = idx.checked_sub(1).map(|below| overhang(&slabs[idx], &filled(&slabs[below]), profile));
        fresh.push_front(overhang.unwrap_or_default());
        above = here;
    }
    widen(&mut supports, slabs, profile);
    if !profile.print.support_on_part {
        keep_to_the_bed(&mut supports, slabs, profile);
    }
    supports
}

/// Makes columns that are narrow on the bed wider, all the way up.
fn widen(supports: &mut [Support], slabs: &[Slab<'_>], profile: &Profile) {
    let Some(first) = supports.first() else { return };
    let half_mm = NARROWEST_COLUMN_MM / 2.0;
    let foot = first.area();
    let wide = foot.offset(-half_mm, TOLERANCE_MM).offset(half_mm, TOLERANCE_MM);
    let pieces = foot.difference(&wide).islands().into_iter();
    let narrow = pieces.filter(|piece| piece.area_mm2() > CORNER * half_mm.powi(2));
    let narrow = Region::new(narrow.flat_map(|piece| piece.contours).collect());
    for idx in 0..supports.len() {
        let column = supports[idx].area();
        let core = column.intersection(&narrow);
        if core.is_empty() {
            return;
        }
        let mut air = slabs[idx].filled(profile).offset(profile.print.support_gap_mm, TOLERANCE_MM);
        for beside in [idx.checked_sub(1), Some(idx + 1)].into_iter().flatten() {
            air = slabs.get(beside).map_or(air.clone(), |slab| air.union(&slab.filled(profile)));
        }
        let mut wider = core.offset(half_mm, TOLERANCE_MM).difference(&air);
        if wider.offset(-half_mm, TOLERANCE_MM).is_empty() {
            // The part is on one side of it.
            wider = wider.offset(half_mm, TOLERANCE_MM).difference(&air);
        }
        let more = wider.difference(&column);
        supports[idx].body = supports[idx].body.union(&more);
    }
}

/// Takes away what stands above any of the part.
fn keep_to_the_bed(supports: &mut [Support], slabs: &[Slab<'_>], profile: &Profile) {
    let mut part_below = Region::default();
    for (support, slab) in supports.iter_mut().zip(slabs) {
        if !support.is_empty() {
            let near = part_below.offset(profile.print.support_gap_mm, TOLERANCE_MM);
            support.leave_out(&near);
        }
        part_below = part_below.union(&slab.filled(profile));
    }
}

/// The lowest place where a column stands on the part: its layer, and where.
pub(super) fn on_part(
    supports: &[Support],
    slabs: &[Slab<'_>],
    profile: &Profile,
) -> Option<(usize, Point2)> {
    (1 + AIR_LAYERS..supports.len()).find_map(|idx| {
        let column = &supports[idx];
        if column.is_empty() {
            return None;
        }
        let foot = column.area().intersection(&slabs[idx - 1 - AIR_LAYERS].filled(profile));
        let wide = foot.offset(-NARROWEST_MM, TOLERANCE_MM);
        Some((idx, wide.contours.first()?.centroid()))
    })
}

/// The column of a layer: what is carried, less the air around the part.
fn cut(
    carried: &Region,
    here: &Region,
    above: &Region,
    below: Option<Region>,
    fresh: &VecDeque<Region>,
    profile: &Profile,
) -> Support {
    let air = here.offset(profile.print.support_gap_mm, TOLERANCE_MM).union(above);
    let air = below.map_or(air.clone(), |below| air.union(&below));
    let column = carried.difference(&air);
    let near: Vec<&Region> = fresh.iter().skip(AIR_LAYERS).take(INTERFACE_LAYERS).collect();
    let interface = column.intersection(&Region::union_all(near));
    Support { body: column.difference(&interface), interface }
}

/// What of a layer lies too far outside the one below.
fn overhang(slab: &Slab<'_>, below: &Region, profile: &Profile) -> Region {
    let reach_mm = slab.height_mm * profile.print.support_overhang_deg.to_radians().tan();
    let beyond = slab.material.difference(&below.offset(reach_mm, TOLERANCE_MM));
    if beyond.is_empty() {
        return beyond;
    }
    let opened = beyond.offset(-NARROWEST_MM / 2.0, TOLERANCE_MM);
    if opened.is_empty() {
        return opened;
    }
    // Back beyond the edge of the layer below: the columns of one slope grow together.
    opened.offset(NARROWEST_MM / 2.0 + reach_mm + LAP_MM, TOLERANCE_MM).intersection(slab.material)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Contour;
    use crate::profile;
    use std::f64::consts::PI;

    const HEIGHT_MM: f64 = 0.2;

    fn with_supports(overhang_deg: f64) -> Profile {
        let mut profile = profile::builtin("reference").unwrap();
        profile.print.support = SupportStyle::Column;
        profile.print.support_overhang_deg = overhang_deg;
        profile
    }

    fn disc(x: f64, radius: f64) -> Region {
        Region::new(vec![Contour::circle(Point2::new(x, 0.0), radius, 360)])
    }

    fn columns_of(materials: &[Region], lumens: &[Region], profile: &Profile) -> Vec<Support> {
        let slab = |(material, lumen)| Slab { material, lumen, height_mm: HEIGHT_MM };
        columns(&materials.iter().zip(lumens).map(slab).collect::<Vec<_>>(), profile)
    }

    /// A cone on its tip, opening by an angle from the vertical.
    fn cone(n: usize, angle_deg: f64) -> Vec<Region> {
        let slope = angle_deg.to_radians().tan();
        (0..n).map(|i| disc(0.0, 2.0 + slope * HEIGHT_MM * i as f64)).collect()
    }

    fn is_none(support: &Support) -> bool {
        support.area().is_empty()
    }

    fn none(n: usize) -> Vec<Region> {
        vec![Region::default(); n]
    }

    #[test]
    fn a_cone_that_opens_within_the_limit_needs_none() {
        let columns = columns_of(&cone(30, 40.0), &none(30), &with_supports(45.0));
        assert!(columns.iter().all(is_none));
    }

    #[test]
    fn the_support_of_a_steep_cone_has_the_volume_computed_by_hand() {
        let (n, angle_deg) = (30, 60.0);
        let profile = with_supports(45.0);
        let columns = columns_of(&cone(n, angle_deg), &none(n), &profile);
        let radius = |i: usize| 2.0 + angle_deg.to_radians().tan() * HEIGHT_MM * i as f64;
        // A ring from the cone, with its air, to the edge of the highest layer that is to be held up; the air above reaches
        // one layer of the slope, which here is narrower than the air beside.
        let gap_mm = profile.print.support_gap_mm.max(radius(1) - radius(0));
        let expected: f64 = (0..n - 1 - AIR_LAYERS)
            .map(|i| HEIGHT_MM * PI * (radius(n - 1).powi(2) - (radius(i) + gap_mm).powi(2)).max(0.0))
            .sum();
        let volume: f64 = columns.iter().map(|s| HEIGHT_MM * s.area().area_mm2()).sum();
        assert!((volume / expected - 1.0).abs() < 5e-3, "{volume} {expected}");
        assert!(is_none(&columns[n - 1]) && is_none(&columns[n - 2]), "air under the top");
        // Up to what rounding to the grid of 10 nm leaves along an edge of some 80 mm.
        let both = columns.iter().map(|s| s.body.intersection(&s.interface).area_mm2());
        assert!(both.fold(0.0, f64::max) < 1e-3);
    }

    /// A tube that leans by an angle from the vertical: wall and lumen.
    fn tube(n: usize, angle_deg: f64) -> (Vec<Region>, Vec<Region>) {
        let x = |i: usize| angle_deg.to_radians().tan() * HEIGHT_MM * i as f64;
        let lumens: Vec<Region> = (0..n).map(|i| disc(x(i), 3.0)).collect();
        let walls = lumens.iter().enumerate().map(|(i, lumen)| disc(x(i), 4.0).difference(lumen));
        (walls.collect(), lumens)
    }

    #[test]
    fn nothing_stands_in_the_lumen_unless_asked() {
        let (walls, lumens) = tube(60, 60.0);
        let mut profile = with_supports(45.0);
        let in_lumen = |profile: &Profile| -> f64 {
            let columns = columns_of(&walls, &lumens, profile);
            columns.iter().zip(&lumens).map(|(s, lumen)| s.area().intersection(lumen).area_mm2()).sum()
        };
        assert!(in_lumen(&profile) < 1e-9);
        let outside: f64 = columns_of(&walls, &lumens, &profile).iter().map(|s| s.area().area_mm2()).sum();
        assert!(outside > 100.0, "the tube's lower side is held up: {outside}");
        profile.print.support_in_lumen = true;
        assert!(in_lumen(&profile) > 10.0, "its roof, too");
    }

    #[test]
    fn columns_under_a_slope_have_no_slits() {
        // A cylinder that leans a little beyond the limit: along a band at its lower side each layer adds a strip no wider than its step.
        let x = |i: usize| 60.0_f64.to_radians().tan() * HEIGHT_MM * i as f64;
        let ellipse = |i: usize, radius: f64| {
            let circle = Contour::circle(Point2::origin(), radius, 64).points;
            Region::new(vec![Contour::new(
                circle.iter().map(|p| Point2::new(x(i) + 2.0 * p.x, p.y)).collect(),
            )])
        };
        let lumens: Vec<Region> = (0..60).map(|i| ellipse(i, 3.0)).collect();
        let walls: Vec<Region> =
            lumens.iter().enumerate().map(|(i, l)| ellipse(i, 4.0).difference(l)).collect();
        let columns = columns_of(&walls, &lumens, &with_supports(55.0));
        for (i, support) in columns[..30].iter().enumerate() {
            let area = support.area();
            let within = area.offset(-0.18, TOLERANCE_MM);
            let share = within.area_mm2() / area.area_mm2();
            assert!(share > 0.75 && within.islands().len() == 1, "layer {i}: {share}");
        }
    }

    #[test]
    fn no_column_stands_on_the_part_where_that_is_not_wanted() {
        // A table top of radius 10 on a foot of radius 8 with a stem of radius 2: columns from foot and bed.
        let part = |i: usize| {
            disc(
                0.0,
                if i < 5 {
                    8.0
                } else if i < 25 {
                    2.0
                } else {
                    10.0
                },
            )
        };
        let part: Vec<Region> = (0..30).map(part).collect();
        let mut profile = with_supports(45.0);
        let lumens = none(30);
        let slabs: Vec<Slab<'_>> = part
            .iter()
            .zip(&lumens)
            .map(|(material, lumen)| Slab { material, lumen, height_mm: HEIGHT_MM })
            .collect();
        let gap_mm = profile.print.support_gap_mm;
        let both = columns(&slabs, &profile);
        // A layer of air above the foot.
        assert_eq!(on_part(&both, &slabs, &profile).unwrap().0, 5 + AIR_LAYERS);
        let ring = |from: f64| PI * (100.0 - from * from);
        assert!((both[15].area().area_mm2() / ring(2.0 + gap_mm) - 1.0).abs() < 0.01);
        profile.print.support_on_part = false;
        let from_bed = columns(&slabs, &profile);
        assert_eq!(on_part(&from_bed, &slabs, &profile), None);
        for support in &from_bed[..23] {
            let area = support.area().area_mm2();
            assert!((area / ring(8.0 + gap_mm) - 1.0).abs() < 0.01, "{area}");
        }
    }

    /// A block with a ledge from layer 40 on that reaches so far out along x or y, and is 25 mm long.
    fn ledge(reach_mm: f64, is_along_x: bool) -> Vec<Region> {
        let place = |u: f64, v: f64| if is_along_x { Point2::new(u, v) } else { Point2::new(v, u) };
        let bar = |to: f64| {
            let bar = Contour::new(
                [(0.0, 0.0), (25.0, 0.0), (25.0, to), (0.0, to)].map(|(u, v)| place(u, v)).to_vec(),
            );
            Region::new(vec![if bar.is_ccw() { bar } else { bar.reversed() }])
        };
        (0..50).map(|i| bar(if i < 40 { 10.0 } else { 10.0 + reach_mm })).collect()
    }

    /// Length of the lines of a column's layer, mm.
    fn printed_mm(support: &Support, layer: usize, kind: BeadKind, profile: &Profile) -> f64 {
        let params = crate::toolpath::fill_params(profile, HEIGHT_MM);
        let paths = support.paths(layer, &params, profile).into_iter().filter(|path| path.kind == kind);
        let length = |path: Path| {
            let first = path.closed.then(|| path.vertices[0]);
            let points: Vec<Point2> = path.vertices.iter().copied().chain(first).map(|v| v.at).collect();
            points.windows(2).map(|p| (p[1] - p[0]).norm()).sum::<f64>()
        };
        paths.map(length).sum()
    }

    #[test]
    fn whatever_its_width_and_direction_a_column_is_printed_in_every_layer_below_its_top() {
        for (reach_mm, is_along_x) in
            [(3.6, true), (3.6, false), (1.5, true), (0.9, true), (0.9, false), (9.0, true)]
        {
            let materials = ledge(reach_mm, is_along_x);
            let profile = with_supports(45.0);
            let columns = columns_of(&materials, &none(materials.len()), &profile);
            // Air, two dense layers, and below them a line along each side at least.
            for (i, column) in columns[..40 - AIR_LAYERS - INTERFACE_LAYERS].iter().enumerate() {
                let printed = printed_mm(column, i, BeadKind::SupportMaterial, &profile);
                assert!(printed > 2.0 * 24.0, "layer {i} of {reach_mm} mm along x {is_along_x}: {printed}");
            }
        }
    }

    #[test]
    fn a_narrow_column_stands_on_a_wide_foot_and_keeps_off_the_part() {
        let materials = ledge(0.9, true);
        let profile = with_supports(45.0);
        let columns = columns_of(&materials, &none(materials.len()), &profile);
        for (i, column) in columns[..36].iter().enumerate() {
            let area = column.area();
            let is_wide = !area.offset(-0.55, TOLERANCE_MM).is_empty();
            let near =
                area.offset(profile.print.support_gap_mm - 0.05, TOLERANCE_MM).intersection(&materials[i]);
            assert!(is_wide && area.islands().len() == 1 && near.area_mm2() < 1e-6, "layer {i}");
        }
    }

    #[test]
    fn columns_keep_off_the_part_beside_above_and_below() {
        let (walls, lumens) = tube(60, 60.0);
        let profile = with_supports(45.0);
        let columns = columns_of(&walls, &lumens, &profile);
        for (i, support) in columns.iter().enumerate() {
            let area = support.area();
            let near = area.offset(profile.print.support_gap_mm - 0.05, TOLERANCE_MM);
            assert!(near.intersection(&walls[i]).area_mm2() < 1e-6, "beside, layer {i}");
            for other in [i.checked_sub(1), Some(i + 1)].into_iter().flatten().filter(|o| *o < walls.len()) {
                assert!(area.intersection(&walls[other]).area_mm2() < 1e-6, "layers {i} and {other}");
            }
        }
    }
}
