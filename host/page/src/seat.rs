//! The client that commands the board for a page: there from the page's request to the disarming, or to the trip.
//!
//! ```text
//!          arm, disarm, clear               done, and not armed; tripped; no beats
//! free ──────────────────────▶ a client ──────────────────────────────────────────▶ goodbye: others may command
//!                               │ each beat of the page is a heartbeat, and there is no other
//! ```

use std::{future::poll_fn, pin::pin, task::Poll};

use futures::{StreamExt, channel::mpsc::UnboundedReceiver, stream::FuturesUnordered};
use r4_driver::{Board, Clock, Error, HeartbeatAnswer};
use r4_protocol::SafetyState;

use crate::{Left, browser::Browser, message::Ask};

/// Order of the page to the client that commands.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ToSeat {
    /// To send a heartbeat.
    Beat,
    /// Request of the user.
    Ask(Ask),
}

/// Event of the client that commands.
enum Event {
    Page(ToSeat),
    Done(Ask, Result<(), Error>),
    Heartbeat(Result<HeartbeatAnswer, Error>),
}

impl<C: Clock> Browser<'_, '_, C> {
    /// Opens a client for each command of the page, and keeps it while the board is armed by it. Never ends by itself.
    pub(crate) async fn seat(&self, mut page: UnboundedReceiver<ToSeat>) -> Left {
        loop {
            let asked = match page.next().await {
                Some(ToSeat::Ask(ask)) => ask,
                // Nothing is armed by this page that its beats could keep.
                Some(ToSeat::Beat) => continue,
                None => std::future::pending().await,
            };
            let commanded = self.page.client(async |board| {
                // From now on those of the page alone.
                board.keep_heartbeat(false);
                self.command(board, asked, &mut page).await;
            });
            let commanded = commanded.await;
            self.is_seated.set(false);
            if let Err(why) = commanded {
                self.answer(asked, &Err(why));
            }
        }
    }

    /// Commands until nothing is armed by this page.
    async fn command(&self, board: &Board<C>, asked: Ask, page: &mut UnboundedReceiver<ToSeat>) {
        let mut heartbeats = board.heartbeat_answers();
        let mut asking = FuturesUnordered::new();
        let ask = |ask: Ask| async move {
            let result = match ask {
                Ask::Arm => board.arm().await,
                Ask::Disarm => board.disarm().await,
                Ask::Clear => board.clear().await,
                Ask::Stop => board.stop().await,
            };
            (ask, result)
        };
        asking.push(ask(asked));
        // Heartbeats that left later say whether the board is still armed by this page.
        let mut armed_us = None;
        while !asking.is_empty() || armed_us.is_some() {
            let event = {
                let mut heartbeat = pin!(heartbeats.next());
                poll_fn(|context| {
                    if let Poll::Ready(Some((ask, result))) = asking.poll_next_unpin(context) {
                        return Poll::Ready(Event::Done(ask, result));
                    }
                    if let Poll::Ready(Some(order)) = page.poll_next_unpin(context) {
                        return Poll::Ready(Event::Page(order));
                    }
                    heartbeat.as_mut().poll(context).map(Event::Heartbeat)
                })
                .await
            };
            match event {
                Event::Page(ToSeat::Beat) => drop(board.send_heartbeat()),
                Event::Page(ToSeat::Ask(next)) => asking.push(ask(next)),
                Event::Done(ask, result) => {
                    match (ask, &result) {
                        (Ask::Arm, Ok(())) => armed_us = Some(board.host_now_us()),
                        (Ask::Disarm, Ok(())) => armed_us = None,
                        _ => {}
                    }
                    self.is_seated.set(armed_us.is_some());
                    self.answer(ask, &result);
                }
                Event::Heartbeat(Ok(HeartbeatAnswer { host_us, state, .. })) => {
                    if armed_us.is_some_and(|armed_us| host_us >= armed_us) && state != SafetyState::Armed {
                        armed_us = None;
                    }
                }
                // The page was silent for several link time-outs: the board has tripped.
                Event::Heartbeat(Err(_)) => return,
            }
        }
    }
}
