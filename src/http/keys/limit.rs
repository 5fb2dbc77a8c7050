//! How much may be asked for in a row: a bucket for each of whom it is asked, which fills again by one after a while.
//!
//! Pure: the time since the start is an argument. A bounded number of buckets is kept; those that were asked for longest ago are
//! forgotten first.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv6Addr};
use std::time::Duration;

/// How much.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rate {
    /// So many in a row.
    pub(super) most: u32,
    /// One more after so long.
    pub(super) refill: Duration,
}

/// Buckets that are kept.
const MOST_BUCKETS: usize = 1024;

/// What is known of one of them.
#[derive(Debug)]
struct Bucket<K> {
    of: K,
    /// When it will be full again: each thing that is counted adds a refill.
    full_at: Duration,
}

/// All of them.
#[derive(Debug)]
pub(super) struct Limit<K> {
    rate: Rate,
    buckets: VecDeque<Bucket<K>>,
}

impl<K: PartialEq> Limit<K> {
    pub(super) const fn new(rate: Rate) -> Self {
        Self { rate, buckets: VecDeque::new() }
    }

    /// Whether another one is allowed; if not, how long until it is.
    pub(super) fn check(&self, of: &K, now: Duration) -> Result<(), Duration> {
        let Some(bucket) = self.buckets.iter().find(|bucket| bucket.of == *of) else { return Ok(()) };
        let allowed_at = bucket.full_at.saturating_sub(self.rate.refill * (self.rate.most - 1));
        if now >= allowed_at { Ok(()) } else { Err(allowed_at - now) }
    }

    /// There was one.
    pub(super) fn count(&mut self, of: K, now: Duration) {
        let found = self.buckets.iter().position(|bucket| bucket.of == of);
        let known = found.and_then(|idx| self.buckets.remove(idx));
        let full_at = known.map_or(now, |bucket| bucket.full_at.max(now)) + self.rate.refill;
        if self.buckets.len() == MOST_BUCKETS {
            self.buckets.pop_front();
        }
        self.buckets.push_back(Bucket { of, full_at });
    }
}

/// What counts of an address: of IPv6 the network of 64 bits, which is what one household has.
pub(super) fn network(address: IpAddr) -> IpAddr {
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
    const RATE: Rate = Rate { most: 10, refill: Duration::from_secs(6) };

    fn wrong(limit: &mut Limit<IpAddr>, address: &str, times: u32) -> IpAddr {
        let address = network(address.parse().unwrap());
        (0..times).for_each(|_| limit.count(address, ZERO));
        address
    }

    #[test]
    fn ten_are_borne_then_one_every_six_seconds() {
        let mut limit = Limit::new(RATE);
        let address = wrong(&mut limit, "192.0.2.1", RATE.most - 1);
        assert_eq!(limit.check(&address, ZERO), Ok(()));
        limit.count(address, ZERO);
        assert_eq!(limit.check(&address, ZERO), Err(RATE.refill));
        assert_eq!(limit.check(&address, RATE.refill), Ok(()));
        limit.count(address, RATE.refill);
        assert_eq!(limit.check(&address, RATE.refill), Err(RATE.refill));
    }

    #[test]
    fn neighbours_in_a_network_share_and_others_do_not() {
        let mut limit = Limit::new(RATE);
        wrong(&mut limit, "2001:db8::1", RATE.most);
        let check =
            |limit: &Limit<IpAddr>, address: &str| limit.check(&network(address.parse().unwrap()), ZERO);
        assert!(check(&limit, "2001:db8::2").is_err());
        assert!(check(&limit, "2001:db8:0:1::1").is_ok());
        wrong(&mut limit, "192.0.2.1", RATE.most);
        assert!(check(&limit, "::ffff:192.0.2.1").is_err());
        assert!(check(&limit, "192.0.2.2").is_ok());
    }

    #[test]
    fn as_many_are_kept_as_there_is_room_for() {
        let mut limit = Limit::new(RATE);
        for number in 0..2000_u32 {
            limit.count(IpAddr::V4(number.into()), ZERO);
        }
        assert_eq!(limit.buckets.len(), MOST_BUCKETS);
    }
}
