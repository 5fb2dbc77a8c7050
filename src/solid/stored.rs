//! A skin that was read: whether its tubes, slabs and welds fit each other, so that nothing stumbles over them later.
//!
//! What it does not do: test whether the surfaces make a valid body (that is `brep::check`).

use super::event::{Crotch, Slab};
use super::skin::{End, Skin, Tube};
use super::weld::{Weld, ends_of};
use crate::spline::PatchSurface;
use serde::Deserialize;

/// A skin as it was read.
#[derive(Deserialize)]
pub(super) struct RawSkin {
    tubes: Vec<Tube>,
    slabs: Vec<Slab>,
    welds: Vec<Weld>,
    moved_mm: f64,
}

/// Parts that do not fit each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum Misfit {
    #[error("tube {0} ends in an event that is not there")]
    End(usize),
    #[error("{slabs} events have {welds} welds")]
    Welds { slabs: usize, welds: usize },
    #[error("event {0} is welded to tubes that do not end in it, or at places that are none")]
    Weld(usize),
    #[error("the patches of event {0} do not lie over their parameters or between its heights")]
    Slab(usize),
}

impl TryFrom<RawSkin> for Skin {
    type Error = Misfit;

    fn try_from(RawSkin { tubes, slabs, welds, moved_mm }: RawSkin) -> Result<Self, Misfit> {
        if slabs.len() != welds.len() {
            return Err(Misfit::Welds { slabs: slabs.len(), welds: welds.len() });
        }
        let stray = |tube: &Tube| [tube.bottom, tube.top].iter().any(|end| !is_there(*end, slabs.len()));
        if let Some(k) = tubes.iter().position(stray) {
            return Err(Misfit::End(k));
        }
        if let Some(k) = slabs.iter().position(|slab| !is_whole(slab)) {
            return Err(Misfit::Slab(k));
        }
        if let Some(k) = (0..welds.len()).find(|&k| !joins(&welds[k], k, &tubes)) {
            return Err(Misfit::Weld(k));
        }
        Ok(Self { tubes, slabs, welds, moved_mm })
    }
}

const fn is_there(end: End, n_slabs: usize) -> bool {
    match end {
        End::Cap => true,
        End::Waist { slab } => slab < n_slabs,
        End::Daughter { slab, side } => slab < n_slabs && side < 2,
    }
}

fn is_whole(slab: &Slab) -> bool {
    const UNIT: [f64; 2] = [0.0, 1.0];
    let [low, high] = slab.w_mm;
    let levels = slab.w_mm.map(|w| slab.v_of(w));
    let is_near = |a: [f64; 2], b: [f64; 2]| (0..2).all(|k| (a[k] - b[k]).abs() < 1e-9);
    let is_over =
        |patch: &PatchSurface, v: [f64; 2]| is_near(patch.u_range(), UNIT) && is_near(patch.v_range(), v);
    let is_saddle = match &slab.crotch {
        Crotch::Saddle(patch) => is_over(patch, UNIT),
        Crotch::Crease => true,
    };
    low.is_finite()
        && high.is_finite()
        && low < high
        && is_saddle
        && slab.laterals.iter().all(|l| is_over(l, levels))
}

fn joins(weld: &Weld, slab: usize, tubes: &[Tube]) -> bool {
    let ends_there = |(tube, end): (&usize, End)| {
        tubes.get(*tube).is_some_and(|tube| tube.bottom == end || tube.top == end)
    };
    let places = weld.waist_u.iter().chain(&weld.daughter_u);
    places.into_iter().all(|u| (0.0..=1.0).contains(u))
        && weld.tubes.iter().zip(ends_of(slab)).all(ends_there)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{cast, phantom_stack};
    use super::*;
    use crate::phantom::Kind;
    use serde_json::{Value, json};

    #[test]
    fn a_skin_is_read_only_where_its_parts_fit() {
        let whole = serde_json::to_value(cast(&phantom_stack(Kind::Merge)).lumen).unwrap();
        let read = |damage: &dyn Fn(&mut Value)| {
            let mut value = whole.clone();
            damage(&mut value);
            serde_json::from_value::<Skin>(value).map_err(|e| e.to_string())
        };
        assert!(read(&|_| {}).is_ok());
        let fault = |damage: &dyn Fn(&mut Value)| read(damage).err().unwrap_or_default();
        assert!(fault(&|v| v["welds"] = json!([])).contains("2 events have 0 welds"));
        assert!(fault(&|v| v["tubes"][1]["top"] = json!({"Waist": {"slab": 9}})).contains("tube 1 ends"));
        assert!(fault(&|v| v["tubes"][0]["top"] = json!("Cap")).contains("welded to tubes"));
        assert!(fault(&|v| v["welds"][1]["tubes"] = json!([0, 1, 99])).contains("event 1 is welded"));
        assert!(fault(&|v| v["welds"][0]["waist_u"] = json!([0.1, 7.0])).contains("event 0 is welded"));
        assert!(fault(&|v| v["slabs"][0]["w_mm"] = json!([3.0, 1.0])).contains("patches of event 0"));
    }
}
