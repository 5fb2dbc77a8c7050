//! How many wrong keys an address may show: a bucket of [`MOST_WRONG`] that fills by one every [`REFILL`].
//!
//! Pure: the time since the start is an argument. Of IPv6 the network of 64 bits counts, which is what one household has. At
//! most [`MOST_ADDRESSES`] are kept, those that were wrong longest ago forgotten first.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv6Addr};
use std::time::Duration;

/// Wrong keys in a row.
const MOST_WRONG: u32 = 10;
/// One more after so long.
const REFILL: Duration = Duration::from_secs(6);
/// Addresses that are kept.
const MOST_ADDRESSES: usize = 1024;

/// What is known of one address.
#[derive(Debug)]
struct Bucket {
    of: IpAddr,
    /// When it will be full again: each wrong key adds a refill.
    full_at: Duration,
}

/// All addresses.
#[derive(Debug, Default)]
pub(super) struct Limit(VecDeque<Bucket>);

impl Limit {
    /// Whether another try is allowed; if not, how long until one is.
    pub(super) fn check(&self, address: IpAddr, now: Duration) -> Result<(), Duration> {
        let of = network(address);
        let Some(bucket) = self.0.iter().find(|bucket| bucket.of == of) else { return Ok(()) };
        let allowed_at = bucket.full_at.saturating_sub(REFILL * (MOST_WRONG - 1));
        if now >= allowed_at { Ok(()) } else { Err(allowed_at - now) }
    }

    /// A key was wrong.
    pub(super) fn count(&mut self, address: IpAddr, now: Duration) {
        let of = network(address);
        let known = self.0.iter().position(|bucket| bucket.of == of).and_then(|idx| self.0.remove(idx));
        let full_at = known.map_or(now, |bucket| bucket.full_at.max(now)) + REFILL;
        if self.0.len() == MOST_ADDRESSES {
            self.0.pop_front();
        }
        self.0.push_back(Bucket { of, full_at });
    }
}

fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => {
            let [a, b, c, d, ..] = v6.segments();
            Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0).into()
        }
        v4 @ IpAddr::V4(_) => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZERO: Duration = Duration::ZERO;

    fn wrong(limit: &mut Limit, address: &str, times: u32) -> IpAddr {
        let address = address.parse().unwrap();
        (0..times).for_each(|_| limit.count(address, ZERO));
        address
    }

    #[test]
    fn ten_wrong_keys_are_borne_then_one_every_six_seconds() {
        let mut limit = Limit::default();
        let address = wrong(&mut limit, "192.0.2.1", MOST_WRONG - 1);
        assert_eq!(limit.check(address, ZERO), Ok(()));
        limit.count(address, ZERO);
        assert_eq!(limit.check(address, ZERO), Err(REFILL));
        assert_eq!(limit.check(address, REFILL), Ok(()));
        limit.count(address, REFILL);
        assert_eq!(limit.check(address, REFILL), Err(REFILL));
    }

    #[test]
    fn neighbours_in_a_network_share_and_others_do_not() {
        let mut limit = Limit::default();
        wrong(&mut limit, "2001:db8::1", MOST_WRONG);
        assert!(limit.check("2001:db8::2".parse().unwrap(), ZERO).is_err());
        assert!(limit.check("2001:db8:0:1::1".parse().unwrap(), ZERO).is_ok());
        wrong(&mut limit, "192.0.2.1", MOST_WRONG);
        assert!(limit.check("::ffff:192.0.2.1".parse().unwrap(), ZERO).is_err());
        assert!(limit.check("192.0.2.2".parse().unwrap(), ZERO).is_ok());
    }

    #[test]
    fn as_many_addresses_are_kept_as_there_is_room_for() {
        let mut limit = Limit::default();
        for number in 0..2000_u32 {
            limit.count(IpAddr::V4(number.into()), ZERO);
        }
        assert_eq!(limit.0.len(), MOST_ADDRESSES);
    }
}
