//! Depth with the color of the same instant, by stamps that are nearly the same; what never pairs is counted.
//!
//! A depth picture takes the color that is nearest to it within the tolerance. It may be sure of that when color has come that is later, or is
//! of its very instant, or is so near that the next one, which comes no sooner than the camera takes pictures, cannot be nearer; otherwise it
//! waits for as long as it has patience. Instants are stamps; patience is counted by the receiver's clock.

use std::collections::VecDeque;

/// Pictures of one kind that wait at most.
const MOST: usize = 8;
/// From how many pictures of color it is told how soon the next one may come.
const GAPS: usize = 8;
/// Depth that is so far before what was used last is of a clock that began anew, nanoseconds, …
const OTHER_CLOCK_NS: u64 = 10_000_000_000;
/// … and so is that whose stamps rise for so many pictures in a row and are before it all the same: a short recording that is played again.
const LATE_IN_A_ROW: usize = 8;
/// Color this far before the color that came last is of a clock that began anew, nanoseconds.
const COLOR_BACK_NS: u64 = 1_000_000_000;

/// How pictures are paired.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairingSettings {
    /// How far apart stamps may be, nanoseconds.
    pub tolerance_ns: u64,
    /// How long depth waits, milliseconds.
    pub patience_ms: u64,
    /// Whether there is color at all.
    pub has_color: bool,
}

/// What has become of the pictures so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PairingCounts {
    /// Pairs, or depth alone where there is no color.
    pub paired: u64,
    /// Depth for which no color came.
    pub depth_alone: u64,
    /// Color for which no depth came.
    pub color_alone: u64,
    /// Depth that came after a later one was used.
    pub late: u64,
}

struct Waiting<T> {
    stamp_ns: u64,
    since_ms: u64,
    picture: T,
}

/// Pairs two streams.
pub struct Pairing<D, C> {
    settings: PairingSettings,
    depths: VecDeque<Waiting<D>>,
    colors: VecDeque<Waiting<C>>,
    /// The stamp of the newest color, and the times between the last ones, nanoseconds.
    newest_color_ns: u64,
    gaps_ns: VecDeque<u64>,
    last_ns: u64,
    /// The stamp of the last depth that was late, and how many in a row were with stamps that rose.
    late: (u64, usize),
    /// What has become of the pictures.
    pub counts: PairingCounts,
}

impl<D, C> Pairing<D, C> {
    /// Nothing so far.
    pub fn new(settings: PairingSettings) -> Self {
        Self {
            settings,
            depths: VecDeque::new(),
            colors: VecDeque::new(),
            newest_color_ns: 0,
            gaps_ns: VecDeque::new(),
            last_ns: 0,
            late: (0, 0),
            counts: PairingCounts::default(),
        }
    }

    /// Takes depth that came at `now_ms`.
    pub fn depth(&mut self, stamp_ns: u64, picture: D, now_ms: u64) {
        if stamp_ns <= self.last_ns {
            if !self.begins_anew(stamp_ns) {
                self.counts.late += 1;
                return;
            }
            self.last_ns = 0;
            self.leave_colors_after(stamp_ns + self.settings.tolerance_ns);
        }
        self.late = (0, 0);
        let at = self.depths.partition_point(|waiting| waiting.stamp_ns <= stamp_ns);
        self.depths.insert(at, Waiting { stamp_ns, since_ms: now_ms, picture });
        if self.depths.len() > MOST {
            self.depths.pop_front();
            self.counts.depth_alone += 1;
        }
    }

    /// Whether depth that is before what was used last is of a clock that began anew, and no late picture.
    fn begins_anew(&mut self, stamp_ns: u64) -> bool {
        let (before_ns, in_a_row) = self.late;
        // A driver that is stuck sends one picture again and again.
        self.late = (stamp_ns, if stamp_ns > before_ns { in_a_row + 1 } else { 1 });
        self.last_ns - stamp_ns >= OTHER_CLOCK_NS || self.late.1 >= LATE_IN_A_ROW
    }

    /// Leaves out the colors of a clock that has begun anew since: as long as one waits, it seems that no nearer one can come.
    fn leave_colors_after(&mut self, last_ns: u64) {
        let kept = self.colors.partition_point(|waiting| waiting.stamp_ns <= last_ns);
        self.counts.color_alone += (self.colors.len() - kept) as u64;
        self.colors.truncate(kept);
    }

    /// Takes color that came at `now_ms`.
    pub fn color(&mut self, stamp_ns: u64, picture: C, now_ms: u64) {
        if stamp_ns > self.newest_color_ns {
            let gap_ns = (self.newest_color_ns > 0).then_some(stamp_ns - self.newest_color_ns);
            self.gaps_ns.extend(gap_ns);
            if self.gaps_ns.len() > GAPS {
                self.gaps_ns.pop_front();
            }
        } else {
            self.gaps_ns.clear();
            if self.newest_color_ns - stamp_ns >= COLOR_BACK_NS {
                self.leave_colors_after(stamp_ns);
            }
        }
        self.newest_color_ns = stamp_ns;
        let at = self.colors.partition_point(|waiting| waiting.stamp_ns <= stamp_ns);
        self.colors.insert(at, Waiting { stamp_ns, since_ms: now_ms, picture });
        if self.colors.len() > MOST {
            self.colors.pop_front();
            self.counts.color_alone += 1;
        }
    }

    /// The next pair that is complete, with its depth's stamp.
    pub fn next(&mut self, now_ms: u64) -> Option<(u64, D, Option<C>)> {
        if !self.settings.has_color {
            let depth = self.depths.pop_front()?;
            (self.last_ns, self.counts.paired) = (depth.stamp_ns, self.counts.paired + 1);
            return Some((depth.stamp_ns, depth.picture, None));
        }
        loop {
            let depth = self.depths.front()?;
            let off_ns = |color: &Waiting<C>| color.stamp_ns.abs_diff(depth.stamp_ns);
            let nearest = (0..self.colors.len()).min_by_key(|i| off_ns(&self.colors[*i]));
            let nearest = nearest.filter(|i| off_ns(&self.colors[*i]) <= self.settings.tolerance_ns);
            let is_sure = self.colors.back().is_some_and(|newest| {
                let before_ns = depth.stamp_ns.saturating_sub(newest.stamp_ns);
                before_ns == 0 || self.least_gap_ns().is_some_and(|gap_ns| gap_ns > 2 * before_ns)
            });
            let waited_ms = now_ms.saturating_sub(depth.since_ms);
            if !is_sure && waited_ms < self.settings.patience_ms {
                return None;
            }
            let depth = self.depths.pop_front()?;
            let Some(nearest) = nearest else {
                self.counts.depth_alone += 1;
                continue;
            };
            // Earlier colors have no depth any more: depths come in order.
            self.counts.color_alone += nearest as u64;
            self.colors.drain(..nearest);
            let color = self.colors.pop_front()?;
            (self.last_ns, self.counts.paired) = (depth.stamp_ns, self.counts.paired + 1);
            return Some((depth.stamp_ns, depth.picture, Some(color.picture)));
        }
    }

    /// How soon after a color the next one may be, with a tenth for what shakes; none until that has been seen.
    fn least_gap_ns(&self) -> Option<u64> {
        let least_ns = self.gaps_ns.iter().min().copied()?;
        (self.gaps_ns.len() == GAPS).then_some(least_ns / 10 * 9)
    }

    /// When the first that waits will have waited long enough.
    pub fn due_ms(&self) -> Option<u64> {
        self.depths.front().map(|depth| depth.since_ms + self.settings.patience_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn pairing(tolerance_ms: u64) -> Pairing<&'static str, &'static str> {
        Pairing::new(PairingSettings { tolerance_ns: tolerance_ms * MS, patience_ms: 100, has_color: true })
    }

    #[test]
    fn depth_takes_the_nearest_color_and_waits_for_it() {
        let mut pairs = pairing(17);
        pairs.color(1000 * MS, "c0", 0);
        pairs.depth(1010 * MS, "d0", 5);
        assert_eq!(pairs.next(10), None, "a nearer one may come");
        pairs.color(1012 * MS, "c1", 12);
        assert_eq!(pairs.next(12), Some((1010 * MS, "d0", Some("c1"))));
        assert_eq!(pairs.counts, PairingCounts { paired: 1, color_alone: 1, ..PairingCounts::default() });
        pairs.depth(1043 * MS, "d1", 40);
        pairs.color(1040 * MS, "c2", 41);
        assert_eq!((pairs.next(50), pairs.due_ms()), (None, Some(140)));
        assert_eq!(pairs.next(140), Some((1043 * MS, "d1", Some("c2"))));
    }

    #[test]
    fn what_has_no_partner_and_what_is_late_is_counted() {
        let mut pairs = pairing(5);
        pairs.depth(1000 * MS, "d0", 0);
        pairs.color(1010 * MS, "c0", 1);
        assert_eq!(pairs.next(2), None);
        assert_eq!(pairs.counts.depth_alone, 1);
        pairs.depth(1010 * MS, "d1", 3);
        assert!(pairs.next(3).is_some());
        pairs.depth(1005 * MS, "d2", 4);
        assert_eq!((pairs.next(4), pairs.counts.late), (None, 1));
        for i in 0..20 {
            pairs.color((2000 + i) * MS, "c", 10);
        }
        assert_eq!((pairs.counts.color_alone, pairs.colors.len()), (12, MOST));
    }

    #[test]
    fn depth_that_is_nearer_to_its_color_than_the_next_can_be_does_not_wait() {
        let settings = PairingSettings { tolerance_ns: 17 * MS, patience_ms: 100, has_color: true };
        let mut pairs = Pairing::<u64, u64>::new(settings);
        for i in 0..12 {
            pairs.color((1000 + 66 * i) * MS, i, 66 * i);
            pairs.depth((1010 + 66 * i) * MS, i, 66 * i + 5);
            let paired = std::iter::from_fn(|| pairs.next(66 * i + 5)).any(|(_, depth, color)| depth == i && color == Some(i));
            // The ninth picture is after the eighth gap.
            assert_eq!(paired, i >= GAPS as u64, "picture {i}");
        }
        // Once one has come that soon, the next may come sooner than this depth is far.
        pairs.color(1756 * MS, 12, 756);
        pairs.depth(1770 * MS, 12, 757);
        assert_eq!(pairs.next(758), None);
        // Stamps that do not rise are another clock.
        pairs.color(1000 * MS, 13, 800);
        assert!(pairs.gaps_ns.is_empty());
    }

    #[test]
    fn a_clock_that_begins_anew_is_followed() {
        let mut pairs = pairing(5);
        pairs.depth(100_000 * MS, "d0", 0);
        pairs.color(100_000 * MS, "c0", 0);
        assert!(pairs.next(0).is_some());
        pairs.depth(5 * MS, "d1", 1);
        pairs.color(5 * MS, "c1", 1);
        assert_eq!(pairs.next(1), Some((5 * MS, "d1", Some("c1"))));
    }

    #[test]
    fn color_of_a_clock_that_is_over_keeps_no_depth_from_waiting() {
        let mut pairs = pairing(5);
        pairs.depth(100_000 * MS, "d0", 0);
        pairs.color(100_000 * MS, "c0", 0);
        assert!(pairs.next(0).is_some());
        // The clock begins anew while a picture of before is still being read.
        pairs.depth(5 * MS, "d1", 1);
        pairs.color(100_033 * MS, "of before", 2);
        pairs.color(5 * MS, "c1", 3);
        assert_eq!(pairs.next(3), Some((5 * MS, "d1", Some("c1"))));
        for (stamp_ms, now_ms) in [(38, 40), (71, 73), (104, 106)] {
            pairs.depth(stamp_ms * MS, "depth", now_ms);
            assert_eq!(pairs.next(now_ms), None, "its color is yet to come");
            pairs.color(stamp_ms * MS, "color", now_ms + 1);
            assert_eq!(pairs.next(now_ms + 1), Some((stamp_ms * MS, "depth", Some("color"))));
        }
        assert_eq!(pairs.counts, PairingCounts { paired: 5, color_alone: 1, ..PairingCounts::default() });
    }

    #[test]
    fn a_short_recording_that_is_played_again_is_followed_and_a_picture_that_is_sent_again_is_late() {
        let mut pairs = pairing(5);
        let mut paired = [0; 3];
        for (i, round) in (0..60u64).map(|i| (i, (i / 20) as usize)) {
            let stamp_ns = (1000 + 33 * (i % 20)) * MS;
            pairs.depth(stamp_ns, "depth", 33 * i);
            pairs.color(stamp_ns, "color", 33 * i + 1);
            paired[round] += std::iter::from_fn(|| pairs.next(33 * i + 1)).count();
        }
        assert_eq!(paired, [20, 21 - LATE_IN_A_ROW, 21 - LATE_IN_A_ROW]);
        for i in 0..30 {
            pairs.depth(1627 * MS, "the last one", 3000 + i);
            assert_eq!(pairs.next(3000 + i), None);
        }
    }
}
