//! The real hand: its commands block until the fingers stand, so they have a thread of their own, and so has listening to it. What both know is
//! on a board of atomics, which the control loop reads without waiting for anybody.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use franka::Gripper;

use super::hand::{HOLDING_M, HandCommand, HandReading};

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

/// What is known of the hand.
#[derive(Debug, Default)]
pub struct HandBoard {
    width_m: AtomicU64,
    grasps: AtomicBool,
    ended: AtomicU64,
    connected: AtomicBool,
    /// How many states it has told.
    told: AtomicU64,
}

impl HandBoard {
    /// What the hand says of itself.
    pub fn reading(&self) -> HandReading {
        // A command's end first: what is read after it is at least as new.
        let ended = self.ended.load(Ordering::Acquire);
        HandReading {
            ended,
            width_m: f64::from_bits(self.width_m.load(Ordering::Acquire)),
            grasps: self.grasps.load(Ordering::Acquire),
            connected: self.connected.load(Ordering::Acquire),
        }
    }

    fn tell(&self, state: &franka::GripperState) {
        self.width_m.store(state.width.to_bits(), Ordering::Release);
        self.grasps.store(state.is_grasped, Ordering::Release);
        self.connected.store(true, Ordering::Release);
        self.told.fetch_add(1, Ordering::AcqRel);
    }
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
                if carry_out(settings, &Arc::new(gripper), board, orders).is_break() {
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
            Ok((number, _)) => board.ended.store(number, Ordering::Release),
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
fn carry_out(
    settings: &HandSettings,
    gripper: &Arc<Gripper>,
    board: &Arc<HandBoard>,
    orders: &Receiver<(u64, HandCommand)>,
) -> std::ops::ControlFlow<()> {
    let (listened, shown) = (gripper.clone(), board.clone());
    let listen = move || {
        while let Ok(state) = listened.read_once() {
            shown.tell(&state);
        }
        shown.connected.store(false, Ordering::Release);
    };
    let listener = match std::thread::Builder::new().name("hand-state".to_owned()).spawn(listen) {
        Ok(listener) => listener,
        Err(error) => {
            tracing::error!(%error, "no thread to listen to the hand");
            return std::ops::ControlFlow::Continue(());
        }
    };
    while !listener.is_finished() {
        let (number, command) = match orders.recv_timeout(Duration::from_millis(50)) {
            Ok(order) => order,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return std::ops::ControlFlow::Break(()),
        };
        let grasp = |width_m, force_n| gripper.grasp(width_m, settings.speed_m_s, force_n, INNER_M, OUTER_M);
        let done = match command {
            HandCommand::Open(width_m) => gripper.move_gripper(width_m, settings.speed_m_s),
            HandCommand::Grasp(width_m, force_n) => grasp(width_m, force_n),
            HandCommand::Close(width_m, force_n) => {
                let moved = gripper.move_gripper(width_m, settings.speed_m_s);
                tell_anew(board);
                // Fingers that something stops are there, whatever the command says of itself.
                if board.reading().width_m > width_m + HOLDING_M { grasp(width_m, force_n) } else { moved }
            }
        };
        match done {
            Ok(true) => {}
            Ok(false) => tracing::info!(?command, "the hand did not reach what it was told"),
            Err(error) => tracing::warn!(?command, %error, "the hand did not carry out a command"),
        }
        // What is on the board may be of the way there.
        tell_anew(board);
        board.ended.store(number, Ordering::Release);
    }
    std::ops::ControlFlow::Continue(())
}

/// Waits until the hand has told two states more, of which the second was made after now; not for long, where it has gone.
fn tell_anew(board: &HandBoard) {
    const LOOK: Duration = Duration::from_millis(5);
    let told = board.told.load(Ordering::Acquire);
    for _ in 0..100 {
        if board.told.load(Ordering::Acquire) >= told + 2 {
            return;
        }
        std::thread::sleep(LOOK);
    }
}
