//! Facets of simple bodies.

use super::Facet;

/// A cuboid from the origin.
pub(crate) fn cuboid(size: [f32; 3]) -> Vec<Facet> {
    let corner = |bits: usize| [0, 1, 2].map(|k| if bits >> k & 1 == 1 { size[k] } else { 0.0 });
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).map(|t| t.map(corner)).collect()
}

/// The same facets moved.
pub(crate) fn moved(facets: &[Facet], by: [f32; 3]) -> Vec<Facet> {
    facets.iter().map(|f| f.map(|corner| [0, 1, 2].map(|k| corner[k] + by[k]))).collect()
}

/// The same facets inside out.
pub(crate) fn inverted(facets: &[Facet]) -> Vec<Facet> {
    facets.iter().map(|&[a, b, c]| [a, c, b]).collect()
}

/// An upright tube about the z axis from z 0 to `height`, in prisms of `n` sides; a rod where `inner` is 0.
pub(crate) fn tube(inner: f32, outer: f32, height: f32, n: u16) -> Vec<Facet> {
    let at = |radius: f32, k: u16, z: f32| {
        let angle = std::f32::consts::TAU * f32::from(k % n) / f32::from(n);
        [radius * angle.cos(), radius * angle.sin(), z]
    };
    let mut facets = Vec::new();
    let mut quad = |a, b, c, d| facets.extend([[a, b, c], [a, c, d]]);
    for k in 0..n {
        let next = k + 1;
        quad(at(outer, k, 0.0), at(outer, next, 0.0), at(outer, next, height), at(outer, k, height));
        quad(at(inner, k, height), at(outer, k, height), at(outer, next, height), at(inner, next, height));
        quad(at(inner, next, 0.0), at(outer, next, 0.0), at(outer, k, 0.0), at(inner, k, 0.0));
        if inner > 0.0 {
            quad(at(inner, k, height), at(inner, next, height), at(inner, next, 0.0), at(inner, k, 0.0));
        }
    }
    facets
}

/// The same facets, those of certain numbers inside out.
pub(crate) fn miswound(facets: &[Facet], is_turned: impl Fn(usize) -> bool) -> Vec<Facet> {
    let turned = |(k, &[a, b, c]): (usize, &Facet)| if is_turned(k) { [a, c, b] } else { [a, b, c] };
    facets.iter().enumerate().map(turned).collect()
}
