//! Outages of the router while a recording is made: what is put and called meanwhile is not in it, and no copy's number shows that, since workers copy
//! their calls only while they see the recorder.

use repose_runtime::transport::ConnectionStatus;

use crate::lost::LostMessages;

/// Follows the connection of a recording's session, and tells of its outages.
pub struct Outages {
    lost: LostMessages,
    /// When the connection was looked at last, nanoseconds since the Unix epoch.
    looked_ns: u64,
    /// Its number then.
    number: u64,
    /// Since when it is down.
    down_since_ns: Option<u64>,
}

impl Outages {
    /// Those after this look at the connection; they are counted in `lost`.
    pub fn after(connection: ConnectionStatus, now_ns: u64, lost: LostMessages) -> Self {
        Self { lost, looked_ns: now_ns, number: connection.number, down_since_ns: None }
    }

    /// Looks at the connection again. One that is up as before and has another number was down between.
    pub fn look(&mut self, connection: ConnectionStatus, now_ns: u64) {
        let changed_ns = now_ns.saturating_sub(connection.since.elapsed().as_nanos() as u64).max(self.looked_ns);
        let returns = connection.number.saturating_sub(self.number);
        if returns > 0 {
            let since_ns = self.down_since_ns.unwrap_or(self.looked_ns);
            // The first of them is counted already where it was seen to begin. Of several they are told as one.
            self.lost.add("outages", returns - u64::from(self.down_since_ns.is_some()));
            self.end(since_ns, changed_ns);
        }
        if !connection.is_up && self.down_since_ns.is_none() {
            tracing::warn!("the router is away: until it is back nothing is recorded");
            self.lost.add("outages", 1);
            self.down_since_ns = Some(changed_ns);
        }
        (self.number, self.looked_ns) = (connection.number, now_ns);
    }

    /// Looks once more, at the end of the recording, which is that of an outage, too.
    pub fn finish(mut self, connection: ConnectionStatus, now_ns: u64) {
        self.look(connection, now_ns);
        if let Some(since_ns) = self.down_since_ns {
            self.end(since_ns, now_ns);
        }
    }

    fn end(&mut self, since_ns: u64, until_ns: u64) {
        let seconds = until_ns.saturating_sub(since_ns) as f64 * 1e-9;
        tracing::warn!(seconds, "nothing was recorded while the router was away");
        self.lost.away(since_ns, until_ns);
        self.down_since_ns = None;
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::time::Duration;

    use tokio::time::{Instant, advance};

    use super::*;

    /// A second after the last look: the connection as it has been since then.
    async fn a_second_later(is_up: bool, number: u64, now_ns: &mut u64) -> ConnectionStatus {
        let since = Instant::now();
        advance(Duration::from_secs(1)).await;
        *now_ns += 1_000_000_000;
        ConnectionStatus { is_up, since, number }
    }

    #[tokio::test(start_paused = true)]
    async fn an_outage_is_counted_once_whether_or_not_somebody_looked_while_it_lasted() {
        for looks in [&[(false, 1), (false, 1), (true, 2), (true, 2)][..], &[(true, 1), (true, 2)]] {
            let (lost, mut now_ns) = (LostMessages::default(), 0);
            let mut outages = Outages::after(a_second_later(true, 1, &mut now_ns).await, now_ns, lost.clone());
            for (is_up, number) in looks {
                let connection = a_second_later(*is_up, *number, &mut now_ns).await;
                outages.look(connection, now_ns);
            }
            outages.finish(a_second_later(true, 2, &mut now_ns).await, now_ns);
            assert_eq!(lost.by_kind(), BTreeMap::from([("outages", 1)]), "{looks:?}");
            assert_eq!(lost.outages().len(), 1, "{looks:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_outage_lasts_from_its_beginning_to_the_routers_return_or_the_end_of_the_recording() {
        const S: u64 = 1_000_000_000;
        let (lost, mut now_ns) = (LostMessages::default(), 0);
        let mut outages = Outages::after(a_second_later(true, 1, &mut now_ns).await, now_ns, lost.clone());
        for (is_up, number) in [(false, 1), (true, 2), (false, 2)] {
            let connection = a_second_later(is_up, number, &mut now_ns).await;
            outages.look(connection, now_ns);
        }
        let connection = a_second_later(false, 2, &mut now_ns).await;
        outages.finish(connection, now_ns);
        assert_eq!(lost.outages(), [[S, 2 * S], [3 * S, 5 * S]]);
        assert_eq!(lost.by_kind(), BTreeMap::from([("outages", 2)]));
    }
}
