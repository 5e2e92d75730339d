//! The real hand: its commands block until the fingers stand, so they have a thread of their own, and so have listening to it and stopping it.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use franka::Gripper;

use super::hand::{HandCommand, HandHalt};
use super::orders::{Fingers, HandBoard, obey, stop_orders};

/// Between two attempts to reach the hand.
const AGAIN: Duration = Duration::from_secs(1);
/// How much less wide than asked the fingers may stand and count as grasping, metres.
const INNER_M: f64 = 0.005;
/// How much wider: whatever keeps them apart is grasped.
const OUTER_M: f64 = 0.08;
/// Commands that may wait: the arm's side sends one after the other.
const WAITING: usize = 4;

/// How to reach a hand.
#[derive(Debug, Clone, PartialEq)]
pub struct HandSettings {
    /// Its address, with `:PORT` where that is another than 1338.
    pub address: String,
    /// How fast the fingers move, m/s.
    pub speed_m_s: f64,
    /// Whether it is to find its widest opening at the start: the fingers close and open.
    pub homes: bool,
}

/// The hand's end of the control loop: its commands go in here.
pub struct HandLink {
    /// Commands with their numbers.
    pub commands: SyncSender<(u64, HandCommand)>,
    /// What is known of it.
    pub board: Arc<HandBoard>,
}

impl HandLink {
    /// Starts the hand's threads; they go on until the process ends or the commands do.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn start(settings: HandSettings) -> std::io::Result<Self> {
        let board = Arc::<HandBoard>::default();
        let (commands, orders) = sync_channel(WAITING);
        let shown = board.clone();
        std::thread::Builder::new().name("hand".to_owned()).spawn(move || run(&settings, &shown, &orders))?;
        Ok(Self { commands, board })
    }

    /// Has the hand leave off what it was told.
    pub fn halt(&self, halt: HandHalt) {
        self.board.halt(halt);
    }
}

/// A connected hand.
struct FrankaHand {
    gripper: Gripper,
    speed_m_s: f64,
}

impl Fingers for FrankaHand {
    fn move_to(&self, width_m: f64) -> Result<bool, String> {
        self.gripper.move_gripper(width_m, self.speed_m_s).map_err(|e| e.to_string())
    }

    fn grasp(&self, width_m: f64, force_n: f64) -> Result<bool, String> {
        self.gripper.grasp(width_m, self.speed_m_s, force_n, INNER_M, OUTER_M).map_err(|e| e.to_string())
    }

    fn stop(&self) -> Result<bool, String> {
        self.gripper.stop().map_err(|e| e.to_string())
    }
}

/// Connects again and again, and carries out commands while connected.
fn run(settings: &HandSettings, board: &Arc<HandBoard>, orders: &Receiver<(u64, HandCommand)>) {
    let mut homes = settings.homes;
    let mut said = String::new();
    loop {
        match connected(settings, &mut homes) {
            Ok(gripper) => {
                tracing::info!(address = settings.address, "the hand is connected");
                said.clear();
                let hand = Arc::new(FrankaHand { gripper, speed_m_s: settings.speed_m_s });
                if carry_out(&hand, board, orders).is_break() {
                    return;
                }
                tracing::warn!(address = settings.address, "the hand is not connected any more");
            }
            Err(error) if error != said => {
                tracing::warn!(address = settings.address, error, "the hand cannot be reached; trying again");
                said = error;
            }
            Err(_) => {}
        }
        // What was asked of a hand that is not there has come to nothing.
        match orders.recv_timeout(AGAIN) {
            Ok((number, _)) => {
                board.fail(number);
                board.end(number);
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

fn connected(settings: &HandSettings, homes: &mut bool) -> Result<Gripper, String> {
    let gripper = Gripper::new(&settings.address).map_err(|e| e.to_string())?;
    if *homes {
        gripper.homing().map_err(|e| e.to_string())?;
        *homes = false;
    }
    Ok(gripper)
}

/// Carries out commands until the connection or the commands end; breaks at the latter.
fn carry_out(hand: &Arc<FrankaHand>, board: &Arc<HandBoard>, orders: &Receiver<(u64, HandCommand)>) -> ControlFlow<()> {
    let over = Arc::new(AtomicBool::new(false));
    let (listened, shown, is_over) = (hand.clone(), board.clone(), over.clone());
    let listen = move || {
        while let Ok(state) = listened.gripper.read_once() {
            shown.tell(state.width, state.is_grasped);
        }
        shown.gone();
        is_over.store(true, Ordering::Release);
    };
    let (stopped, halted, is_over) = (hand.clone(), board.clone(), over.clone());
    let stop = move || stop_orders(&*stopped, &halted, || is_over.load(Ordering::Acquire));
    let threads = std::thread::Builder::new().name("hand-stop".to_owned()).spawn(stop).and_then(|_| {
        let listener = std::thread::Builder::new().name("hand-state".to_owned());
        listener.spawn(listen)
    });
    if let Err(error) = threads {
        tracing::error!(%error, "no threads to listen to the hand and to stop it");
        over.store(true, Ordering::Release);
        return ControlFlow::Continue(());
    }
    while !over.load(Ordering::Acquire) {
        match orders.recv_timeout(Duration::from_millis(50)) {
            Ok(order) => obey(&**hand, board, order),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                over.store(true, Ordering::Release);
                return ControlFlow::Break(());
            }
        }
    }
    ControlFlow::Continue(())
}
