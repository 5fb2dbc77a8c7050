//! Going on after a reset: behind the last line that was certainly executed, where that is safe.

use super::doubt::{Doubt, behind_s};
use super::restore::restoring;
use super::{COOLED_K, Decision, Known, MOTOR_STEP_MM, Plan, Recovery, Refusal, Why};
use crate::printer::job;
use crate::printer::journal::Track;
use crate::printer::replay::Modal;
use crate::profile::{Dialect, Profile, ResumePoint};
use std::io::{BufRead, Seek};

/// A bed that has cooled by more than this holds no part, K.
const COLD_K: f64 = 30.0;
/// How far above the part the nozzle travels, mm.
const CLEARANCE_MM: f64 = 5.0;
/// Heights that differ by less are one, mm.
const SAME_MM: f64 = 1e-6;

impl<R: BufRead + Seek> Plan<'_, R> {
    pub(super) fn recover(&mut self, why: Why) -> Result<Decision, job::Error> {
        if self.is_within_recovery() {
            return Ok(Decision::Refuse(Refusal::WithinRecovery { why }));
        }
        let mut doubt = self.doubt()?;
        if self.known.progress.is_away {
            doubt.high_mm = f64::INFINITY;
        }
        let recovery = self.recovery(why, doubt);
        Ok(recovery.map_or_else(Decision::Refuse, |recovery| Decision::Recover(Box::new(recovery))))
    }

    /// What may be executed, and what may not.
    fn doubt(&mut self) -> Result<Doubt, job::Error> {
        let progress = &self.known.progress;
        let n_lines = self.job.n_lines();
        let n_done = progress.n_certain;
        let reach = self.reach;
        let unrecorded = if reach.is_waiting { 0 } else { self.unrecorded() };
        let n_sent = progress.n_sent.max(n_done).min(n_lines) + unrecorded;
        let since_s = progress.begun_s + if self.known.is_behind { behind_s(progress) } else { 0.0 };
        let Track { prelude, n_before, .. } = &self.known.track;
        let own = &prelude[..usize::try_from(reach.n_prelude).unwrap_or(usize::MAX).min(prelude.len())];
        let mut doubt = Doubt::new(self.profile.firmware.dialect, progress, reach, since_s);
        let take_own = |doubt: &mut Doubt| own.iter().for_each(|line| doubt.take_own(line));
        if *n_before == 0 {
            take_own(&mut doubt);
        }
        let mut n = 0;
        self.job.replay(n_sent, |command| {
            doubt.take(command);
            n += 1;
            if n == *n_before {
                take_own(&mut doubt);
            }
        })?;
        Ok(doubt)
    }

    fn recovery(&self, why: Why, mut doubt: Doubt) -> Result<Recovery, Refusal> {
        let n_done = self.known.progress.n_certain;
        let n_twice = doubt.n - n_done;
        let modal = doubt.at.take().ok_or(Refusal::NothingPrinted { why })?;
        let mut point = self.point(why, &modal)?;
        let cooled_k = self.cooled_k(why, point.bed_c)?;
        point.nozzle_z_mm = self.height(why, point.xyz_mm[2], &doubt, n_twice)?;
        // Never down before X and Y are found.
        point.clear_z_mm = point.clear_z_mm.max(point.nozzle_z_mm);
        let mut commands = self.profile.recovery_gcode(&point);
        commands.extend(restoring(&modal));
        Ok(Recovery {
            why,
            n_done,
            n_lines: self.job.n_lines(),
            n_twice,
            twice_mm: doubt.printed_mm,
            xyz_mm: point.xyz_mm,
            cooled_k,
            commands,
            picture: None,
            modal,
        })
    }

    /// Where it goes on and how warm, by the state behind the last certain line.
    fn point(&self, why: Why, modal: &Modal) -> Result<ResumePoint, Refusal> {
        let ([Some(x), Some(y), Some(z), _], Some(hotend_c), Some(top_mm)) =
            (modal.at_mm, modal.hotend_c, modal.top_mm)
        else {
            return Err(Refusal::NothingPrinted { why });
        };
        if self.profile.scripts.recovery.is_empty() {
            return Err(Refusal::NoScript { why });
        }
        if let Some(beyond) = modal.beyond {
            return Err(Refusal::Beyond { why, beyond });
        }
        let clear_z_mm = top_mm.max(z) + CLEARANCE_MM;
        let bed_c = modal.bed_c.unwrap_or(0.0);
        Ok(ResumePoint { xyz_mm: [x, y, z], nozzle_z_mm: z, clear_z_mm, hotend_c, bed_c })
    }

    /// How far the bed has cooled, where that matters; refused where the part cannot hold any more.
    fn cooled_k(&self, why: Why, bed_c: f64) -> Result<Option<f64>, Refusal> {
        let cooled_k = self.survey.temperatures.bed.map(|bed| bed_c - bed.actual_c);
        match cooled_k.filter(|k| *k > COOLED_K) {
            Some(cooled_k) if cooled_k > COLD_K => Err(Refusal::PartCold { why, cooled_k }),
            cooled_k => Ok(cooled_k),
        }
    }

    /// The height at which the nozzle stands, mm: that of the part, or where it waits in a pause. Refused where it may be at another
    /// one.
    fn height(&self, why: Why, z_mm: f64, doubt: &Doubt, n_lines: u64) -> Result<f64, Refusal> {
        let is_one = doubt.high_mm - doubt.low_mm <= SAME_MM;
        let is_near = |told_mm: f64, mm: f64| (told_mm - mm).abs() <= MOTOR_STEP_MM;
        let [low_mm, high_mm] = match self.told_height().filter(|_| why != Why::Restarted) {
            Some(told_mm) if is_near(told_mm, z_mm) => [z_mm, z_mm],
            Some(told_mm) if is_one && is_near(told_mm, doubt.low_mm) => [doubt.low_mm; 2],
            // Somebody has moved it, or it has gone on further than is known.
            Some(told_mm) => [told_mm.min(z_mm), told_mm.max(z_mm)],
            None => [doubt.low_mm, doubt.high_mm],
        };
        let is_known = high_mm - low_mm <= SAME_MM && (is_near(low_mm, z_mm) || self.tells_height());
        if is_known {
            Ok(low_mm)
        } else if homes_z(self.profile) {
            Ok(z_mm)
        } else {
            Err(Refusal::HeightUnknown { why, low_mm: low_mm.min(z_mm), high_mm: high_mm.max(z_mm), n_lines })
        }
    }

    /// Whether the profile's recovery can be told a height of the nozzle that is not the part's. Marlin 1's soft endstops let no axis
    /// go below where it was when the board started.
    fn tells_height(&self) -> bool {
        let goes_lower = self.profile.firmware.dialect != Dialect::Marlin1;
        goes_lower && self.profile.scripts.recovery.iter().any(|line| line.contains("{resume_nozzle_z_mm}"))
    }

    /// Whether the last session was to find the part again and may not have come to it: the nozzle stands anywhere above.
    fn is_within_recovery(&self) -> bool {
        let Known { track, progress, .. } = self.known;
        let finds_again = track.prelude.iter().any(|line| line.starts_with("G92") && line.contains('Z'));
        finds_again && progress.n_certain <= track.n_before
    }

    /// Z by the printer's own word, mm.
    fn told_height(&self) -> Option<f64> {
        self.survey.position.map(|position| position.xyz_mm[2])
    }
}

/// Whether the profile's recovery finds the height again by itself.
fn homes_z(profile: &Profile) -> bool {
    let homes = |line: &String| {
        let mut words = line.split_ascii_whitespace();
        let is_homing = words.next() == Some("G28");
        let axes: Vec<_> = words.collect();
        is_homing && (axes.is_empty() || axes.iter().any(|axis| axis.starts_with('Z')))
    };
    profile.scripts.recovery.iter().any(homes)
}

/// Whether a recovery is possible, and has to know the height.
pub(in crate::printer) fn needs_height(profile: &Profile) -> bool {
    !profile.scripts.recovery.is_empty() && !homes_z(profile)
}
