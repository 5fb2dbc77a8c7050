use super::*;
use crate::geom::RigidTransform;
use crate::mesh::SkinChoice;
use crate::phantom::{Kind as Vessels, Vessel};
use crate::progress::Task;
use crate::sections::{PlaneSections, SectionStack};
use crate::solid::{Body as Wanted, Params, Solid, build};

fn solid(planes: Vec<PlaneSections>, body: Wanted) -> Solid {
    let stack = SectionStack { planes, patient_from_stack: RigidTransform::identity() };
    build(&stack, &Params::new(body), &Task::quiet()).unwrap().solid
}

fn phantom(kind: Vessels, body: Wanted) -> Solid {
    let vessel = Vessel::new(kind);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    solid((0..46).map(plane).collect(), body)
}

#[test]
fn tmp_probe() {
    for kind in [Vessels::Carotid] {
        let s = phantom(kind, Wanted::Cast);
        let b = Brep::of(&s, SkinChoice::All);
        println!("{kind:?} V {} {:?} jump {:?}", b.volume_mm3(), check(&b), b.normal_jump_deg(21));
        for (e, edge) in b.edges.iter().enumerate() {
            let [a, c] = edge.curve.range();
            let mut uses = Vec::new();
            for f in &b.faces {
                let Some(sp) = f.surface.spline() else { continue };
                for ce in f.loops.iter().flat_map(|l| &l.coedges) {
                    if ce.edge == e {
                        uses.push((f.surface.name(), sp, ce.trace));
                    }
                }
            }
            if uses.len() < 2 {
                continue;
            }
            print!("{e} {} {} {:?}:", uses[0].0, uses[1].0, edge.curve.ends().map(|p| p.z));
            for k in 0..21 {
                let sh = (k as f64 + 0.5) / 21.0;
                let n: Vec<_> = uses
                    .iter()
                    .map(|u| {
                        let [x, y] = along(u.2, sh);
                        let j = u.1.jet(x, y);
                        j.by_u.cross(&j.by_v)
                    })
                    .collect();
                print!(" {:.2}", n[0].angle(&n[1]).to_degrees());
                let _ = (a, c);
            }
            println!();
        }
    }
}
