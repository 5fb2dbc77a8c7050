//! Where a series over layers or planes leaves its nominal value (zero): from where to where, how far, and whether at once or
//! little by little.
//!
//! The series is cut where it jumps (a step that is unlike the steps beside it); what deviates within a piece is one span.
//! A span whose values follow its line is gradual, and begins where that line leaves zero. Many short spans in a row are
//! one that varies.

use crate::geom::Vector2;

/// Steps beside one another are alike when neither is more than so many times the other.
const ALIKE: f64 = 3.0;
/// A span whose values follow a line with this correlation is gradual.
const GRADUAL: f64 = 0.8;
/// More spans than this without a gap are one that varies.
const MOST_SPANS: usize = 4;

/// A stretch that deviates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Span {
    /// First and last place.
    pub(super) first: usize,
    pub(super) last: usize,
    /// The deviation at both ends; the same where it is constant.
    pub(super) begin: Vector2,
    pub(super) end: Vector2,
    /// Root mean square of what the two do not explain.
    pub(super) spread: f64,
    /// Whether it grows or fades.
    pub(super) is_gradual: bool,
}

impl Span {
    /// The larger deviation of both ends.
    pub(super) fn most(&self) -> Vector2 {
        if self.begin.norm() > self.end.norm() { self.begin } else { self.end }
    }
}

/// The stretches of a series of scalars that deviate by more than `least`; [`Span::begin`] and `end` hold them in x.
pub(super) fn of_scalars(values: &[Option<f64>], least: f64) -> Vec<Span> {
    let vectors: Vec<Option<Vector2>> = values.iter().map(|v| v.map(|v| Vector2::new(v, 0.0))).collect();
    spans(&vectors, least)
}

/// The stretches of a series that deviate by more than `least`; places without a value are passed over.
pub(super) fn spans(values: &[Option<Vector2>], least: f64) -> Vec<Span> {
    let known: Vec<(usize, Vector2)> =
        values.iter().enumerate().filter_map(|(i, v)| v.map(|v| (i, v))).collect();
    let mut spans = Vec::new();
    let mut begin = 0;
    for i in 1..=known.len() {
        if i == known.len() || is_jump(&known, i, least) {
            spans.extend(within(&known[begin..i], least));
            begin = i;
        }
    }
    joined(with_edges(spans), &known)
}

/// A single place that deviates less than the long span beside it, the same way, is where that one begins or ends.
fn with_edges(spans: Vec<Span>) -> Vec<Span> {
    let mut kept: Vec<Span> = Vec::new();
    for span in spans {
        match kept.last_mut() {
            Some(before) if before.last + 1 == span.first && is_edge(&span, before) => {
                before.last = span.last
            }
            Some(before) if before.last + 1 == span.first && is_edge(before, &span) => {
                *before = Span { first: before.first, ..span };
            }
            _ => kept.push(span),
        }
    }
    kept
}

fn is_edge(one: &Span, of: &Span) -> bool {
    let (a, b) = (one.begin, of.most());
    one.first == one.last
        && of.last >= of.first + 2
        && !of.is_gradual
        && a.norm() < b.norm()
        && a.dot(&b) > 0.9 * a.norm() * b.norm()
}

/// Whether the value at `i` lies off the one before by a step of its own.
fn is_jump(known: &[(usize, Vector2)], i: usize, least: f64) -> bool {
    let step = |i: usize| (i > 0 && i < known.len()).then(|| known[i].1 - known[i - 1].1);
    let Some(own) = step(i).filter(|s| s.norm() > least) else { return false };
    let alike = |other: Option<Vector2>| {
        other.is_some_and(|o| {
            let ratio = o.norm() / own.norm();
            o.dot(&own) > 0.0 && (1.0 / ALIKE..=ALIKE).contains(&ratio)
        })
    };
    !alike(step(i - 1)) && !alike(step(i + 1))
}

/// The deviating stretches of a piece without jumps.
fn within(piece: &[(usize, Vector2)], least: f64) -> Vec<Span> {
    let mut spans = Vec::new();
    let mut begin = 0;
    while let Some(first) = (begin..piece.len()).find(|&i| piece[i].1.norm() > least) {
        let last = (first..piece.len()).take_while(|&i| piece[i].1.norm() > least).last().unwrap_or(first);
        spans.push(span(piece, first, last, least));
        begin = last + 1;
    }
    spans
}

fn span(piece: &[(usize, Vector2)], first: usize, last: usize, least: f64) -> Span {
    let own = &piece[first..=last];
    let few = own.len().min(3);
    let (low, high) = (middle(&own[..few]), middle(&own[own.len() - few..]));
    let is_gradual = (high - low).norm() > least && correlation(own, high - low) > GRADUAL;
    if is_gradual {
        // What led there was too small to count.
        let reached = |i: usize| (first > 0 && i == first) || (i == last && last + 1 < piece.len());
        let per_place = (high - low).norm() / (own.len() - 1) as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few places")]
        let lead = |v: Vector2| (v.norm() / per_place).round() as usize;
        let first = if reached(first) { first.saturating_sub(lead(low)) } else { first };
        let last = if reached(last) { (last + lead(high)).min(piece.len() - 1) } else { last };
        return Span {
            first: piece[first].0,
            last: piece[last].0,
            begin: low,
            end: high,
            spread: 0.0,
            is_gradual,
        };
    }
    let value = middle(own);
    Span {
        first: own[0].0,
        last: own[own.len() - 1].0,
        begin: value,
        end: value,
        spread: spread(own, value),
        is_gradual,
    }
}

/// The component-wise median.
fn middle(values: &[(usize, Vector2)]) -> Vector2 {
    let of = |get: fn(&Vector2) -> f64| {
        super::super::image::median(values.iter().map(|(_, v)| get(v))).unwrap_or(0.0)
    };
    Vector2::new(of(|v| v.x), of(|v| v.y))
}

fn spread(values: &[(usize, Vector2)], about: Vector2) -> f64 {
    (values.iter().map(|(_, v)| (v - about).norm_squared()).sum::<f64>() / values.len() as f64).sqrt()
}

/// Correlation of the place with the value along `direction`.
fn correlation(values: &[(usize, Vector2)], direction: Vector2) -> f64 {
    let n = values.len() as f64;
    let pairs = || values.iter().map(|(i, v)| (*i as f64, v.dot(&direction)));
    let (mx, my) = pairs().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let (xx, xy, yy) = pairs().fold((0.0, 0.0, 0.0), |(xx, xy, yy), (x, y)| {
        (xx + (x - mx) * (x - mx), xy + (x - mx) * (y - my), yy + (y - my) * (y - my))
    });
    if xx * yy > 0.0 { xy / (xx * yy).sqrt() } else { 0.0 }
}

/// Too many spans in a row become one.
fn joined(spans: Vec<Span>, known: &[(usize, Vector2)]) -> Vec<Span> {
    let mut runs: Vec<Vec<Span>> = Vec::new();
    for span in spans {
        match runs.last_mut() {
            Some(run) if run.last().is_some_and(|l| span.first <= l.last + 3) => run.push(span),
            _ => runs.push(vec![span]),
        }
    }
    runs.into_iter()
        .flat_map(|run| if run.len() > MOST_SPANS { vec![varying(&run, known)] } else { run })
        .collect()
}

fn varying(run: &[Span], known: &[(usize, Vector2)]) -> Span {
    let (first, last) = (run[0].first, run[run.len() - 1].last);
    let own: Vec<(usize, Vector2)> =
        known.iter().copied().filter(|(i, _)| (first..=last).contains(i)).collect();
    let mean = own.iter().map(|(_, v)| *v).sum::<Vector2>() / own.len() as f64;
    Span { first, last, begin: mean, end: mean, spread: spread(&own, mean), is_gradual: false }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scalars(n: usize, value: impl Fn(usize) -> f64) -> Vec<Span> {
        of_scalars(&(0..n).map(|i| Some(value(i))).collect::<Vec<_>>(), 0.03)
    }

    #[test]
    fn what_stays_nominal_has_no_span() {
        assert!(scalars(50, |i| if i % 2 == 0 { 0.01 } else { -0.01 }).is_empty());
        assert!(of_scalars(&[None, None], 0.03).is_empty());
    }

    #[test]
    fn a_step_and_its_end_are_found_to_the_place() {
        let found = scalars(60, |i| if (20..30).contains(&i) { 0.4 } else { 0.0 });
        assert!(matches!(found[..], [Span { first: 20, last: 29, is_gradual: false, .. }]), "{found:?}");
        assert!((found[0].begin.x - 0.4).abs() < 1e-12);
        let one = scalars(60, |i| if i == 7 { -0.4 } else { 0.0 });
        assert!(matches!(one[..], [Span { first: 7, last: 7, .. }]), "{one:?}");
    }

    #[test]
    fn two_steps_are_two_spans() {
        let found = scalars(60, |i| {
            if i < 20 {
                0.0
            } else if i < 40 {
                0.4
            } else {
                0.9
            }
        });
        assert!(
            matches!(found[..], [Span { first: 20, last: 39, .. }, Span { first: 40, last: 59, .. }]),
            "{found:?}"
        );
    }

    #[test]
    fn a_place_that_is_half_off_belongs_to_the_span_beside_it() {
        let found = scalars(60, |i| match i {
            19 => 0.1,
            20..30 => 0.4,
            30 => 0.2,
            _ => 0.0,
        });
        assert!(matches!(found[..], [Span { first: 19, last: 30, .. }]), "{found:?}");
        assert!((found[0].begin.x - 0.4).abs() < 1e-12);
    }

    #[test]
    fn slow_and_fast_growth_is_gradual_from_where_it_begins() {
        for per_place in [0.004, 0.05] {
            let found = scalars(120, |i| per_place * i.saturating_sub(20) as f64);
            let [span] = found[..] else { panic!("{found:?}") };
            assert!(span.is_gradual && span.first.abs_diff(20) <= 1 && span.last == 119, "{span:?}");
            assert!((span.end.x - per_place * 98.0).abs() < 1.5 * per_place, "{span:?}");
        }
    }

    #[test]
    fn restless_values_are_one_span_that_varies() {
        let found =
            scalars(60, |i| if (10..50).contains(&i) { 0.2 + 0.1 * (i as f64 * 2.4).sin() } else { 0.0 });
        let [span] = found[..] else { panic!("{found:?}") };
        assert!(
            (span.first, span.last) == (10, 49) && (span.begin.x - 0.2).abs() < 0.03 && span.spread > 0.05
        );
    }
}
