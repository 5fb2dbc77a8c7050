use super::*;

fn wire() -> Wire {
    let mut firmware = crate::profile::builtin("marlin").unwrap().firmware;
    // Three lines of 12 or 13 bytes, and the probe.
    firmware.rx_buffer_bytes = 20 + 3 * 13;
    Wire::new(&firmware)
}

fn send_all(wire: &mut Wire) -> usize {
    std::iter::from_fn(|| wire.send_next().map(str::len)).count()
}

#[test]
fn the_checksum_is_the_exclusive_or() {
    let mut out = String::new();
    write_numbered(&mut out, 3, "T0");
    assert_eq!(out, "N3 T0*57\n");
}

#[test]
fn no_more_bytes_are_in_flight_than_the_buffer_holds() {
    let mut wire = wire();
    (0..8).for_each(|_| wire.push("G1 X1", Origin::Job));
    assert_eq!(send_all(&mut wire), 3);
    assert!(wire.ack_oldest());
    assert_eq!(send_all(&mut wire), 1);
}

#[test]
fn lines_in_the_command_queue_do_not_count_as_in_the_buffer() {
    let mut wire = wire();
    (0..8).for_each(|_| wire.push("G1 X1", Origin::Job));
    send_all(&mut wire);
    // Of four slots one is free: the line acknowledged and two more are in the queue.
    assert!(wire.ack_through(1, Some(1)));
    assert_eq!(send_all(&mut wire), 3);
    assert_eq!(wire.in_flight(), 5);
}

#[test]
fn a_little_more_is_under_way_while_the_firmware_waits_at_no_line() {
    let mut firmware = crate::profile::builtin("marlin").unwrap().firmware;
    firmware.baud = 1_000_000;
    let mut wire = Wire::new(&firmware);
    let mut most = [0; 2];
    let mut now = Instant::default();
    for n in 0..20_000 {
        while wire.unsent() < 600 {
            wire.push("G1 X100.123 Y90.456 E0.01234", Origin::Job);
        }
        send_all(&mut wire);
        let n_moves = if n < 10_000 { 15 } else { 0 };
        let most = &mut most[usize::from(n_moves == 0)];
        *most = wire.in_flight().max(if n % 10_000 < 9_000 { 0 } else { *most });
        // Each answer is late: the more is in flight, the more is answered in the same time.
        now = now + Duration::from_micros((1600 / wire.in_flight()).max(430));
        assert!(wire.ack_oldest());
        wire.planner_has_room(now, n_moves);
    }
    assert_eq!(most, [4, 2], "with room in the planner, and without");
}

#[test]
fn a_line_longer_than_the_buffer_goes_alone() {
    let mut wire = wire();
    wire.push(&"X".repeat(90), Origin::Job);
    wire.push("G1", Origin::Job);
    assert_eq!(send_all(&mut wire), 1);
}

#[test]
fn unnumbered_lines_go_ahead_as_far_as_the_link_holds_them() {
    let mut firmware = crate::profile::builtin("marlin").unwrap().firmware;
    firmware.line_numbers = false;
    firmware.rx_buffer_bytes = PROBE_BYTES + 7;
    let mut wire = Wire::new(&firmware);
    ["G1", "G2", "G3"].iter().for_each(|text| wire.push(text, Origin::Job));
    assert_eq!(wire.send_next(), Some("G1\n"));
    assert_eq!(wire.send_next(), Some("G2\n"));
    assert_eq!(wire.send_next(), None);
    wire.ack_oldest();
    assert_eq!(wire.send_next(), Some("G3\n"));
}

/// The most that was in flight while so many lines were acknowledged, one every `line_us`.
fn most_in_flight(wire: &mut Wire, n_lines: u32, line_us: u64) -> u64 {
    let mut now = Instant::default();
    let mut most = 0;
    for _ in 0..n_lines {
        while wire.unsent() < 600 {
            wire.push("G1 X100.123 Y90.456 E0.01234", Origin::Job);
        }
        send_all(wire);
        most = most.max(wire.in_flight());
        now = now + Duration::from_micros(line_us);
        assert!(wire.ack_oldest());
        wire.measure(now);
    }
    most
}

#[test]
fn a_link_that_is_no_wire_takes_more_until_a_line_is_damaged() {
    let firmware = crate::profile::builtin("marlin").unwrap().firmware;
    // A line at 1,000,000 baud takes 430 microseconds.
    assert!(most_in_flight(&mut Wire::new(&firmware), 9000, 430) <= 3);
    let mut wire = Wire::new(&firmware);
    assert!(most_in_flight(&mut wire, 9000, 50) > 80);
    wire.narrow();
    while wire.in_flight() > 0 {
        wire.ack_oldest();
    }
    assert!(most_in_flight(&mut wire, 9000, 50) <= 3, "for good");
}

#[test]
fn a_session_may_begin_behind_any_line() {
    let mut wire = wire();
    wire.begin_after(4711);
    wire.push("G1 X1", Origin::Job);
    assert!(wire.send_next().unwrap().starts_with("N4712 "));
    assert_eq!((wire.in_flight(), wire.oldest(), wire.highest()), (1, 4712, 4712));
    assert!(wire.ack_oldest());
    assert_eq!(wire.acked_job_lines(), 1);
}

#[test]
fn a_rewind_takes_back_acknowledgements() {
    let mut wire = wire();
    (0..8).for_each(|_| wire.push("G1 X1", Origin::Job));
    send_all(&mut wire);
    wire.ack_oldest();
    wire.ack_oldest();
    assert_eq!(wire.acked_job_lines(), 2);
    wire.rewind(2);
    assert_eq!((wire.acked(), wire.acked_job_lines(), wire.next()), (1, 1, 2));
    assert!(wire.send_next().unwrap().starts_with("N2 "));
}

#[test]
fn lines_that_were_sent_once_keep_their_numbers() {
    let mut wire = wire();
    (0..8).for_each(|i| wire.push(&format!("G1 X{i}"), Origin::Job));
    send_all(&mut wire);
    wire.rewind(2);
    wire.drop_unsent();
    assert_eq!(wire.queued(), 3);
    wire.push("M104 S0", Origin::Host);
    assert_eq!(wire.command(3), Some("G1 X2"));
    assert_eq!(wire.command(4), Some("M104 S0"));
}

#[test]
fn the_history_is_bounded_and_long_enough() {
    let mut wire = wire();
    for _ in 0..10_000 {
        wire.push("G1 X1", Origin::Job);
        assert!(wire.send_next().is_some() && wire.ack_oldest());
    }
    assert!(wire.lines.len() <= 257 && wire.spare.len() <= 1);
    assert_eq!((wire.oldest(), wire.acked_job_lines()), (10_000 - 255, 10_000));
    wire.rewind(wire.oldest());
    assert_eq!(wire.acked_job_lines(), 10_000 - 256);
}
