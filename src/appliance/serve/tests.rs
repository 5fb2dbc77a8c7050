//! Parts that fail, and what the units in `deploy/` make of a server that gives up.

use super::*;
use crate::appliance::watchman::{LONG_LIFE, MOST_RESTARTS, Patience, REST};

/// A value of a unit, in the words of the file.
fn of_unit(key: &str) -> &'static str {
    let unit = include_str!("../../../deploy/lumenfab.service");
    let mut values = unit.lines().filter_map(|line| line.strip_prefix(key)?.strip_prefix('='));
    values.next().unwrap_or_else(|| panic!("{key}= is not in the unit"))
}

#[test]
fn a_part_rests_longer_each_time_and_begins_anew_after_a_long_life() {
    let rests = |patience: &mut Patience| -> Vec<Duration> {
        std::iter::from_fn(|| patience.rest_after(Duration::ZERO)).collect()
    };
    let mut patience = Patience::default();
    let first = rests(&mut patience);
    assert_eq!(first.len(), MOST_RESTARTS as usize);
    assert!(first.is_sorted() && [first[0], first[9]] == REST, "{first:?}");
    assert_eq!(patience.rest_after(LONG_LIFE), None);
    assert_eq!(patience.rest_after(2 * LONG_LIFE), Some(first[0]));
    assert_eq!(rests(&mut patience), first[1..]);
}

/// However slowly its parts fail, a server that gives up over and over is left stopped; the watch beside it sees to the heaters.
#[test]
fn a_server_that_gives_up_does_not_outrun_the_start_limit() {
    let mut patience = Patience::default();
    let resting: Duration = std::iter::from_fn(|| patience.rest_after(Duration::ZERO)).sum();
    let longest = LONG_LIFE * (MOST_RESTARTS + 1) + resting + LAST_PRINT + LAST_NEWS;
    let restart = Duration::from_secs(of_unit("RestartSec").parse().unwrap());
    let hours: u64 = of_unit("StartLimitIntervalSec").strip_suffix('h').unwrap().parse().unwrap();
    let burst: u32 = of_unit("StartLimitBurst").parse().unwrap();
    let all = (longest + restart) * burst;
    assert!(all < Duration::from_secs(hours * 3600), "{all:?}");
    assert_eq!((of_unit("Wants"), of_unit("Restart")), ("lumenfab-safe-off.service", "always"));
}

/// Hidden from it, every start would doubt every bed.
#[test]
fn the_unit_lets_the_server_see_which_run_of_the_machine_it_is() {
    let unit = include_str!("../../../deploy/lumenfab.service");
    assert!(!unit.lines().any(|line| line == "ProcSubset=pid"));
}
