//! G-code that brings a printer back to the state in which the job had left it.

use crate::printer::replay::Modal;

/// Heat and fan as the job left them.
pub(in crate::printer) fn warming(modal: &Modal) -> Vec<String> {
    let heats = |set: &str, celsius: Option<f64>| celsius.filter(|c| *c > 0.0).map(|c| format!("{set} S{c}"));
    let heat =
        [("M140", modal.bed_c), ("M104", modal.hotend_c), ("M190", modal.bed_c), ("M109", modal.hotend_c)];
    let fan = modal.fan.filter(|fan| *fan > 0.0).map(|fan| format!("M106 S{fan}"));
    heat.into_iter().filter_map(|(set, celsius)| heats(set, celsius)).chain(fan).collect()
}

/// Limits and factors, the filament drawn back, modes, its place, fan and speed as the job left them.
pub(super) fn restoring(modal: &Modal) -> Vec<String> {
    let rounded = |value: f64| (value * 1e5).round() / 1e5;
    let mut lines: Vec<_> = modal.settings.iter().map(|setting| setting.line.clone()).collect();
    if modal.drawn_mm > 0.0 {
        lines.push("M83".to_owned());
        lines.push(format!("G1 E-{} F1800", rounded(modal.drawn_mm)));
    }
    lines.extend(modal.at_mm[3].map(|e| format!("G92 E{}", rounded(e))));
    lines.push(if modal.absolute_xyz { "G90" } else { "G91" }.to_owned());
    lines.push(if modal.absolute_e { "M82" } else { "M83" }.to_owned());
    lines.extend(modal.fan.map(|fan| if fan > 0.0 { format!("M106 S{fan}") } else { "M107".to_owned() }));
    lines.extend(modal.feedrate_mm_min.map(|feedrate| format!("G1 F{}", rounded(feedrate))));
    lines
}
