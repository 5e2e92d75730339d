//! The cells that a viewer may choose from.

use std::collections::BTreeSet;
use std::sync::Arc;

use repose_proto::{CallError, keys};
use repose_runtime::Session;

use crate::messages::ServerMessage;
use crate::viewers::{Audience, Topic};

/// The cells there are: those with anybody alive. Told to `audience` whenever it changes, until the network closes.
///
/// # Errors
/// When the network refuses.
pub async fn follow_cells(session: &Session, audience: Arc<Audience>) -> Result<impl Future<Output = ()> + use<>, CallError> {
    let mut alive = session.watch_lives().await?;
    Ok(async move {
        let mut told = None;
        loop {
            let cells: BTreeSet<String> =
                alive.current().iter().filter_map(|key| keys::of_live(key)).map(|(cell, ..)| cell.to_owned()).collect();
            if told.as_ref() != Some(&cells) {
                audience.tell(&Topic::Cells, &ServerMessage::Cells { cells: cells.iter().cloned().collect() }.encode());
                told = Some(cells);
            }
            if !alive.changed().await {
                return;
            }
        }
    })
}
