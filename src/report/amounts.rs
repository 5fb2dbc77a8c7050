//! Volumes, filament and time: planned against recorded.

use super::course::slopes;
use super::deviation::rounded;
use serde::Serialize;

/// What the job takes, as planned and as recorded, where the case knows it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Job {
    /// Estimated time, s.
    #[serde(serialize_with = "rounded")]
    pub planned_s: Option<f64>,
    /// Time that it took, s.
    #[serde(serialize_with = "rounded")]
    pub recorded_s: Option<f64>,
    /// Filament of the G-code, mm.
    #[serde(serialize_with = "rounded")]
    pub planned_filament_mm: Option<f64>,
    /// Filament pushed, mm.
    #[serde(serialize_with = "rounded")]
    pub recorded_filament_mm: Option<f64>,
}

/// All amounts.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Amounts {
    /// Lumen between the first and the last CT plane, one entry a stage.
    pub lumen: Vec<LumenVolume>,
    /// Lumen (a cast: material) of all layers, ends beyond the CT planes included, mm³.
    #[serde(serialize_with = "rounded")]
    pub layers_mm3: Option<f64>,
    /// Material of the planned beads, mm³.
    #[serde(serialize_with = "rounded")]
    pub planned_material_mm3: Option<f64>,
    /// Material recorded near the job, mm³.
    #[serde(serialize_with = "rounded")]
    pub recorded_material_mm3: Option<f64>,
    /// Time and filament.
    #[serde(flatten)]
    pub job: Job,
}

/// The volume of a lumen as one stage has it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LumenVolume {
    /// The stage.
    pub stage: &'static str,
    /// Volume, mm³; `null` where a plane is missing.
    #[serde(serialize_with = "rounded")]
    pub volume_mm3: Option<f64>,
    /// Half of what the integral changes when every second plane is left out, mm³.
    #[serde(serialize_with = "rounded")]
    pub uncertainty_mm3: Option<f64>,
}

/// The integral of the areas over the heights.
pub(super) fn lumen_volume(stage: &'static str, z_mm: &[f64], areas_mm2: &[Option<f64>]) -> LumenVolume {
    let areas: Option<Vec<f64>> = areas_mm2.iter().copied().collect();
    let volume_mm3 = areas.as_ref().map(|a| integral(z_mm, a));
    let last = z_mm.len() - 1;
    let kept: Vec<usize> = (0..z_mm.len()).filter(|k| k % 2 == 0 || *k == last).collect();
    let coarse = areas.as_ref().filter(|_| z_mm.len() > 4).map(|a| {
        let z: Vec<f64> = kept.iter().map(|&k| z_mm[k]).collect();
        integral(&z, &kept.iter().map(|&k| a[k]).collect::<Vec<_>>())
    });
    let uncertainty_mm3 = volume_mm3.zip(coarse).map(|(a, b)| 0.5 * (a - b).abs());
    LumenVolume { stage, volume_mm3, uncertainty_mm3 }
}

/// Trapezium rule with the ends' slopes of every interval: exact for cubics.
fn integral(at: &[f64], values: &[f64]) -> f64 {
    let slopes = slopes(at, values);
    let piece = |i: usize| {
        let h = at[i + 1] - at[i];
        0.5 * h * (values[i] + values[i + 1]) + h * h / 12.0 * (slopes[i] - slopes[i + 1])
    };
    (0..at.len().saturating_sub(1)).map(piece).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cone_of_uneven_planes_has_its_volume() {
        let z = [0.0, 2.0, 3.0, 6.0, 9.0, 10.0];
        let areas = z.map(|z: f64| Some(std::f64::consts::PI * (1.0 + 0.2 * z).powi(2)));
        let expected = std::f64::consts::PI * (27.0 - 1.0) / 0.6;
        let found = lumen_volume("solid", &z, &areas);
        assert!((found.volume_mm3.unwrap() - expected).abs() < 1e-9 && found.uncertainty_mm3.unwrap() < 1e-9);
        let gap = [Some(1.0), None, Some(1.0)];
        assert_eq!(lumen_volume("image", &[0.0, 1.0, 2.0], &gap).volume_mm3, None);
    }
}
