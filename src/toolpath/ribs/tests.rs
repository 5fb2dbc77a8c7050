use super::scene::GRIP_MM;
use super::*;
use crate::gcode;
use crate::geom::SegmentIndex;
use crate::profile;
use crate::progress::Task;
use crate::slice::LayerSlot;
use crate::toolpath::{Bead, LayerPaths, Planned, plan};

const HEIGHT_MM: f64 = 0.2;
/// Radii of the tubes' skins, mm.
const RADII_MM: [f64; 2] = [0.8, 1.6];
/// Six times their width.
const SLENDER_MM: f64 = 19.2;

fn with_ribs(name: &str) -> Profile {
    let mut profile = profile::builtin(name).unwrap();
    (profile.print.ribs, profile.print.rib_slenderness, profile.print.rib_span_mm) = (true, 6.0, 10.0);
    profile.print.skirt_loops = 0;
    profile
}

/// A tube by its foot and by how it leans, mm a mm.
#[derive(Debug, Clone, Copy)]
struct Tube {
    foot: [f64; 2],
    lean: [f64; 2],
}

fn upright(x: f64) -> Tube {
    Tube { foot: [x, 0.0], lean: [0.0, 0.0] }
}

fn disc(x: f64, y: f64, radius: f64) -> Region {
    Region::new(vec![Contour::circle(Point2::new(x, y), radius, 90)])
}

fn slot(i: usize) -> LayerSlot {
    LayerSlot { z_mid_mm: HEIGHT_MM * (i as f64 + 0.5), height_mm: HEIGHT_MM, ct_plane: None }
}

fn tubes(tubes: &[Tube], height_mm: f64) -> Vec<Layer> {
    let layer = |i: usize| {
        let slot = slot(i);
        let skins = |radius: f64| {
            let at = |t: &Tube, axis: usize| t.foot[axis] + t.lean[axis] * slot.z_mid_mm;
            let discs: Vec<Region> = tubes.iter().map(|t| disc(at(t, 0), at(t, 1), radius)).collect();
            Region::union_all(&discs)
        };
        let lumen = skins(RADII_MM[0]);
        Layer { slot, material: skins(RADII_MM[1]).difference(&lumen), lumen }
    };
    (0..).take_while(|i| HEIGHT_MM * (*i as f64) < height_mm).map(layer).collect()
}

fn planned(layers: &[Layer], profile: &Profile) -> Planned {
    plan(layers, profile, &Task::quiet()).unwrap()
}

fn of_kind(layer: &LayerPaths, kind: BeadKind) -> Vec<&Bead> {
    layer.beads.iter().filter(|b| b.kind == kind).collect()
}

/// What beads cover, their round ends left aside.
fn covered(beads: &[&Bead]) -> Region {
    let strokes = beads.iter().flat_map(|b| b.points.windows(2)).map(|pair| {
        let (a, b) = (pair[0].at, pair[1].at);
        let along = (b - a).normalize();
        let aside = Vector2::new(-along.y, along.x) * (pair[0].width_mm / 2.0);
        Region::new(vec![Contour::new(vec![a - aside, b - aside, b + aside, a + aside])])
    });
    Region::union_all(&strokes.collect::<Vec<_>>())
}

/// Heights at which struts begin, mm.
fn begins(planned: &Planned) -> Vec<f64> {
    let has = |i: usize| !of_kind(&planned.paths.layers[i], BeadKind::Rib).is_empty();
    let first = |i: &usize| has(*i) && (*i == 0 || !has(i - 1));
    (0..planned.paths.layers.len()).filter(first).map(|i| HEIGHT_MM * i as f64).collect()
}

/// What must be true of ribs, whatever they hold.
fn check(planned: &Planned, profile: &Profile, what: &str) {
    let layers = &planned.paths.layers;
    let mut below = Region::default();
    let mut posts_below: Vec<&Bead> = Vec::new();
    for (i, layer) in layers.iter().enumerate() {
        let (struts, posts) = (of_kind(layer, BeadKind::Rib), of_kind(layer, BeadKind::SupportMaterial));
        let (bars, feet) = (covered(&struts), covered(&posts));
        let in_lumen = bars.union(&feet).intersection(&layer.lumen).area_mm2();
        assert!(in_lumen < 1e-9, "{what}: {in_lumen} mm2 in the lumen of layer {i}");
        let near = feet.offset(profile.print.support_gap_mm - 0.05, 0.01).intersection(&layer.material);
        assert!(near.area_mm2() < 1e-6, "{what}: a post touches the part in layer {i}");
        let pressed = bars.intersection(&layer.material).area_mm2();
        assert!(pressed <= 0.15 * struts.len() as f64, "{what}: {pressed} mm2 in the wall of layer {i}");
        if i > 0 {
            let off_mm = |p: Point2| {
                let lines = posts_below.iter().flat_map(|b| b.points.windows(2));
                let off = lines.map(|l| (nearest_on_segment(p, l[0].at, l[1].at) - p).norm());
                off.fold(f64::INFINITY, f64::min)
            };
            let farthest = posts.iter().flat_map(|b| &b.points).map(|p| off_mm(p.at)).fold(0.0, f64::max);
            assert!(farthest < 0.05, "{what}: a post hangs over by {farthest} mm in layer {i}");
        }
        for strut in &struts {
            let bar = covered(&[strut]);
            let resting = bar.intersection(&below).area_mm2() / bar.area_mm2();
            let (from, to) = (strut.points[0].at, strut.points[strut.points.len() - 1].at);
            let length_mm = (to - from).norm();
            let holds = |end: Point2| {
                let on = layer.material.union(&feet.without_holes());
                SegmentIndex::try_new(&on.contours).unwrap().signed_distance_mm(end) < 0.01
            };
            assert!(holds(from) && holds(to), "{what}: an end of a strut hangs in layer {i}");
            let is_bridge = length_mm <= profile.print.rib_span_mm + 2.0 * GRIP_MM + 2e-3;
            assert!(is_bridge && !(0.25..=0.85).contains(&resting), "{what}: {resting} rests in layer {i}");
        }
        below = layer.material.union(&bars).union(&feet);
        posts_below = posts;
    }
}

#[test]
fn slender_branches_hold_each_other_where_the_slenderness_says() {
    let profile = with_ribs("reference");
    let planned = planned(&tubes(&[upright(0.0), upright(8.0)], 41.0), &profile);
    assert_eq!(planned.warnings, []);
    check(&planned, &profile, "two upright tubes");
    let begins = begins(&planned);
    let expected = [SLENDER_MM, 1.5 * SLENDER_MM, 2.0 * SLENDER_MM];
    let is_there = |(a, b): (&f64, &f64)| (a - b).abs() < 0.5;
    assert!(begins.len() == 3 && begins.iter().zip(&expected).all(is_there), "{begins:?}");
    let layers = &planned.paths.layers;
    assert!(layers.iter().all(|l| of_kind(l, BeadKind::SupportMaterial).is_empty()), "no post is needed");
    // A strut is four layers high, and from skin to skin.
    let struts: Vec<&Bead> = layers.iter().flat_map(|l| of_kind(l, BeadKind::Rib)).collect();
    assert_eq!(struts.len(), 12);
    let length_mm = |b: &Bead| (b.points[b.points.len() - 1].at - b.points[0].at).norm();
    assert!(struts.iter().all(|b| (length_mm(b) - (8.0 - 2.0 * RADII_MM[1] + 2.0 * GRIP_MM)).abs() < 0.02));
    // Narrow where it breaks away.
    let narrow = |b: &Bead| b.points[0].width_mm < 0.8 * b.points[b.points.len() / 2].width_mm;
    assert!(struts.iter().all(|b| narrow(b)));
}

#[test]
fn a_branch_that_is_no_higher_than_the_slenderness_gets_none() {
    let planned = planned(&tubes(&[upright(0.0), upright(8.0)], SLENDER_MM), &with_ribs("reference"));
    assert!(begins(&planned).is_empty());
}

#[test]
fn a_branch_is_as_high_as_it_has_risen_above_its_joint() {
    // Two tubes upon a trunk of 10 mm.
    let (trunk_mm, profile) = (10.0, with_ribs("reference"));
    let mut layers = tubes(&[upright(-2.6), upright(2.6)], trunk_mm + 25.0);
    for layer in layers.iter_mut().filter(|l| l.slot.z_mid_mm < trunk_mm) {
        layer.material = disc(0.0, 0.0, 5.0).difference(&layer.lumen);
    }
    let planned = planned(&layers, &profile);
    check(&planned, &profile, "two tubes on a trunk");
    let begins = begins(&planned);
    assert!(begins.len() == 1 && (begins[0] - trunk_mm - SLENDER_MM).abs() < 0.5, "{begins:?}");
}

#[test]
fn a_lone_branch_is_held_by_a_post_on_the_bed() {
    for name in ["reference", "marlin"] {
        let profile = with_ribs(name);
        let planned = planned(&tubes(&[upright(0.0)], 41.0), &profile);
        assert_eq!(planned.warnings, []);
        check(&planned, &profile, name);
        assert_eq!(begins(&planned).len(), 3);
        let layers = &planned.paths.layers;
        let has = |l: &LayerPaths, kind| !of_kind(l, kind).is_empty();
        let top = layers.iter().rposition(|l| has(l, BeadKind::SupportMaterial)).unwrap();
        assert_eq!(Some(top), layers.iter().rposition(|l| has(l, BeadKind::Rib)));
        assert!(layers[..=top].iter().all(|l| has(l, BeadKind::SupportMaterial)), "from the bed upward");
        // By its own slenderness as wide as it is high.
        let foot = covered(&of_kind(&layers[0], BeadKind::SupportMaterial)).bounds().unwrap().size();
        let high_mm = HEIGHT_MM * (top + 1) as f64;
        assert!(foot.x.min(foot.y) >= high_mm / profile.print.rib_slenderness, "{foot:?} under {high_mm} mm");
    }
}

#[test]
fn ribs_keep_their_promises_beside_leaning_and_crowded_branches() {
    let leaning = |x: f64, lean: [f64; 2]| Tube { foot: [x, 0.0], lean };
    let cases: [(&str, Vec<Tube>); 5] = [
        ("one that leans", vec![leaning(0.0, [0.2, 0.1])]),
        ("one that leans far", vec![leaning(0.0, [0.5, 0.0])]),
        ("two that part", vec![leaning(0.0, [-0.1, 0.0]), leaning(5.0, [0.12, 0.05])]),
        ("two that meet", vec![leaning(0.0, [0.1, 0.0]), leaning(14.0, [-0.1, 0.02])]),
        ("a row", vec![upright(0.0), upright(4.5), upright(9.0), upright(20.0)]),
    ];
    for (what, all) in cases {
        for support in [profile::SupportStyle::None, profile::SupportStyle::Column] {
            let mut profile = with_ribs("reference");
            profile.print.support = support;
            let planned = planned(&tubes(&all, 42.0), &profile);
            if support == profile::SupportStyle::None {
                check(&planned, &profile, what);
                let all_held = planned.warnings.iter().all(|w| w.code != "toolpath.unsteady");
                assert!(!begins(&planned).is_empty() && all_held, "{what}: {:?}", planned.warnings);
            }
            for (i, layer) in planned.paths.layers.iter().enumerate() {
                let around: Vec<&Bead> = layer.beads.iter().filter(|b| !b.kind.is_part()).collect();
                let in_lumen = covered(&around).intersection(&layer.lumen).area_mm2();
                assert!(in_lumen < 1e-9, "{what}: {in_lumen} mm2 in the lumen of layer {i}");
            }
        }
    }
}

#[test]
fn what_finds_no_room_is_told() {
    let mut profile = with_ribs("reference");
    profile.machine.bed_mm = [5.0, 5.0, 250.0];
    let planned = planned(&tubes(&[upright(0.0)], 41.0), &profile);
    assert!(begins(&planned).is_empty());
    let [warning] = &planned.warnings[..] else { panic!("{:?}", planned.warnings) };
    assert_eq!(warning.code, "toolpath.unsteady");
    assert!(warning.text.starts_with("3 place(s)") && warning.text.contains("z 19."), "{}", warning.text);
}

#[test]
fn without_ribs_their_settings_change_nothing() {
    let layers = tubes(&[upright(0.0), upright(8.0)], 25.0);
    let job = |profile: &Profile| {
        let text = gcode::write(&planned(&layers, profile).paths, profile, &gcode::Header::default());
        // The hash is of all settings.
        text.lines().filter(|l| !l.starts_with("; settings")).collect::<Vec<_>>().join("\n")
    };
    let plain = profile::builtin("reference").unwrap();
    assert!(!plain.print.ribs);
    let mut other = plain.clone();
    (other.print.rib_slenderness, other.print.rib_span_mm) = (1.0, 50.0);
    assert!(job(&plain) == job(&other));
    other.print.ribs = true;
    assert!(job(&plain) != job(&other));
}

#[test]
fn ribs_are_the_same_on_any_number_of_threads_and_told_in_the_job() {
    let layers = tubes(&[upright(0.0), Tube { foot: [9.0, 0.0], lean: [0.3, 0.2] }], 30.0);
    let profile = with_ribs("marlin");
    let job = || gcode::write(&planned(&layers, &profile).paths, &profile, &gcode::Header::default());
    let on = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(job);
    let text = on(1);
    assert!(text == on(3));
    assert!(text.contains(";TYPE:Support material\n"));
    let filament = |text: &str| -> f64 {
        let line = text.lines().find_map(|l| l.strip_prefix("; filament_mm ")).unwrap();
        line.parse().unwrap()
    };
    let mut without = profile.clone();
    without.print.ribs = false;
    let bare = gcode::write(&planned(&layers, &without).paths, &without, &gcode::Header::default());
    assert!(filament(&text) > filament(&bare) + 1.0);
}
