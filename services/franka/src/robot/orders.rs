//! What a hand is told: orders, one after the other, and that it is to leave off.
//!
//! An order blocks until the fingers stand, so whoever stops the hand does it from elsewhere. What both know is on a board of atomics, which the
//! control loop reads and writes without waiting for anybody.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use super::hand::{HOLDING_M, HandCommand, HandHalt, HandReading};

/// Between two looks at the board.
const LOOK: Duration = Duration::from_millis(5);
/// Between two stops of an order that has not ended.
const STOP_AGAIN: Duration = Duration::from_millis(100);

/// What is known of the hand.
#[derive(Debug, Default)]
pub struct HandBoard {
    width_m: AtomicU64,
    grasps: AtomicBool,
    ended: AtomicU64,
    failed: AtomicU64,
    connected: AtomicBool,
    /// How many states it has told.
    told: AtomicU64,
    /// The order under way; 0 where there is none.
    running: AtomicU64,
    /// Orders up to this one are not begun any more.
    void_to: AtomicU64,
    /// Of those, the one under way is stopped up to this one.
    stop_to: AtomicU64,
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
            failed: self.failed.load(Ordering::Acquire),
            connected: self.connected.load(Ordering::Acquire),
        }
    }

    /// It has told a state.
    pub fn tell(&self, width_m: f64, grasps: bool) {
        self.width_m.store(width_m.to_bits(), Ordering::Release);
        self.grasps.store(grasps, Ordering::Release);
        self.connected.store(true, Ordering::Release);
        self.told.fetch_add(1, Ordering::AcqRel);
    }

    /// It is not connected any more.
    pub fn gone(&self) {
        self.connected.store(false, Ordering::Release);
    }

    /// An order has ended, or come to nothing.
    pub fn end(&self, number: u64) {
        self.ended.store(number, Ordering::Release);
    }

    /// The hand could not carry out an order. One that it was to leave off may end so too, and is no failure.
    pub fn fail(&self, number: u64) {
        if !self.is_void(number) {
            self.failed.store(number, Ordering::Release);
        }
    }

    /// It is to leave off what it was told.
    pub fn halt(&self, halt: HandHalt) {
        // Sequentially consistent, as what follows: an order that begins at this moment sees that it is void, or is seen to run.
        self.void_to.store(halt.up_to, Ordering::SeqCst);
        if halt.stops {
            self.stop_to.store(halt.up_to, Ordering::SeqCst);
        }
    }

    fn is_void(&self, number: u64) -> bool {
        number <= self.void_to.load(Ordering::SeqCst)
    }

    fn is_to_stop(&self) -> bool {
        let running = self.running.load(Ordering::SeqCst);
        running != 0 && running <= self.stop_to.load(Ordering::SeqCst)
    }

    /// Has a part of an order done, unless the order is void by now: none then.
    fn run<T>(&self, number: u64, part: impl FnOnce() -> T) -> Option<T> {
        self.running.store(number, Ordering::SeqCst);
        let done = (!self.is_void(number)).then(part);
        self.running.store(0, Ordering::SeqCst);
        done
    }
}

/// What moves a hand's fingers. Each call blocks until they stand, and `stop` ends another one; whether they reached what they were told, or why
/// they could not.
pub trait Fingers {
    /// To a width, metres.
    fn move_to(&self, width_m: f64) -> Result<bool, String>;
    /// Closes on what should be wider than a width, metres, and presses with a force, newtons.
    fn grasp(&self, width_m: f64, force_n: f64) -> Result<bool, String>;
    /// Stops them.
    fn stop(&self) -> Result<bool, String>;
}

/// Carries out an order.
pub fn obey(fingers: &impl Fingers, board: &HandBoard, (number, command): (u64, HandCommand)) {
    let done = match command {
        HandCommand::Open(width_m) => board.run(number, || fingers.move_to(width_m)),
        HandCommand::Grasp(width_m, force_n) => board.run(number, || fingers.grasp(width_m, force_n)),
        HandCommand::Close(width_m, force_n) => {
            let moved = board.run(number, || fingers.move_to(width_m));
            tell_anew(board);
            // Fingers that something stops are there, whatever the command says of itself.
            let is_blocked = moved.is_some() && board.reading().width_m > width_m + HOLDING_M;
            if is_blocked { board.run(number, || fingers.grasp(width_m, force_n)) } else { moved }
        }
    };
    match done {
        Some(Ok(true)) => {}
        Some(Ok(false)) => tracing::info!(?command, "the hand did not reach what it was told"),
        Some(Err(error)) => {
            tracing::warn!(?command, error, "the hand did not carry out a command");
            board.fail(number);
        }
        None => tracing::info!(?command, "the hand leaves a command off: the robot is stopped"),
    }
    // What is on the board may be of the way there.
    tell_anew(board);
    board.end(number);
}

/// Stops whatever order is to be stopped, until it is `over`: again and again, for a stop that overtakes its order is of no effect.
pub fn stop_orders(fingers: &impl Fingers, board: &HandBoard, over: impl Fn() -> bool) {
    while !over() {
        if !board.is_to_stop() {
            std::thread::sleep(LOOK);
            continue;
        }
        if let Err(error) = fingers.stop() {
            tracing::warn!(error, "the hand did not take a stop");
        }
        std::thread::sleep(STOP_AGAIN);
    }
}

/// Waits until the hand has told two states more, of which the second was made after now; not for long, where it has gone.
fn tell_anew(board: &HandBoard) {
    let told = board.told.load(Ordering::Acquire);
    for _ in 0..100 {
        if board.told.load(Ordering::Acquire) >= told + 2 {
            return;
        }
        std::thread::sleep(LOOK);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    /// Fingers that something blocks at 4 cm, where they push until they are stopped.
    #[derive(Default)]
    struct Blocked {
        board: HandBoard,
        calls: Mutex<Vec<&'static str>>,
        stopped: AtomicBool,
    }

    impl Blocked {
        fn called(&self, call: &'static str) {
            self.calls.lock().expect("calls").push(call);
        }

        fn push(&self) -> Result<bool, String> {
            for _ in 0..2000 {
                self.board.tell(0.04, false);
                if self.stopped.swap(false, Ordering::SeqCst) {
                    return Err("Command aborted!".to_owned());
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            Ok(false)
        }
    }

    impl Fingers for Blocked {
        fn move_to(&self, _: f64) -> Result<bool, String> {
            self.called("move");
            self.push()
        }

        fn grasp(&self, _: f64, _: f64) -> Result<bool, String> {
            self.called("grasp");
            Ok(true)
        }

        fn stop(&self) -> Result<bool, String> {
            self.called("stop");
            self.stopped.store(true, Ordering::SeqCst);
            Ok(true)
        }
    }

    /// Fingers that end every order at once, with one answer; where they are halted, the order was to be left off meanwhile.
    struct Answering {
        board: HandBoard,
        answer: Result<bool, String>,
        is_halted: bool,
    }

    impl Answering {
        fn answered(&self) -> Result<bool, String> {
            if self.is_halted {
                self.board.halt(HandHalt { up_to: 1, stops: true });
            }
            self.answer.clone()
        }
    }

    impl Fingers for Answering {
        fn move_to(&self, _: f64) -> Result<bool, String> {
            self.answered()
        }

        fn grasp(&self, _: f64, _: f64) -> Result<bool, String> {
            self.answered()
        }

        fn stop(&self) -> Result<bool, String> {
            Ok(true)
        }
    }

    #[test]
    fn an_error_is_a_failure_and_closing_on_nothing_is_none() {
        let error: Result<bool, String> = Err("Command failed!".to_owned());
        for (answer, is_halted, failed) in [(error.clone(), false, 1), (error, true, 0), (Ok(false), false, 0), (Ok(true), false, 0)] {
            let hand = Answering { board: HandBoard::default(), answer, is_halted };
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    while hand.board.reading().ended < 1 {
                        hand.board.tell(0.0, false);
                        std::thread::yield_now();
                    }
                });
                obey(&hand, &hand.board, (1, HandCommand::Grasp(0.02, 30.0)));
            });
            assert_eq!(hand.board.reading().failed, failed, "{:?}, halted: {is_halted}", hand.answer);
        }
    }

    #[test]
    fn an_order_under_way_is_stopped_and_neither_it_nor_one_that_waits_goes_on() {
        let hand = Blocked::default();
        std::thread::scope(|scope| {
            scope.spawn(|| stop_orders(&hand, &hand.board, || hand.board.reading().ended >= 2));
            scope.spawn(|| {
                obey(&hand, &hand.board, (1, HandCommand::Close(0.0, 20.0)));
                obey(&hand, &hand.board, (2, HandCommand::Grasp(0.0, 20.0)));
            });
            while hand.board.running.load(Ordering::SeqCst) != 1 {
                std::thread::yield_now();
            }
            hand.board.halt(HandHalt { up_to: 2, stops: true });
        });
        let mut calls = hand.calls.into_inner().expect("calls");
        calls.dedup();
        assert_eq!((calls, hand.board.reading().ended), (vec!["move", "stop"], 2));
    }

    #[test]
    fn what_is_held_is_not_let_go_and_later_orders_are_carried_out() {
        let hand = Blocked::default();
        hand.board.halt(HandHalt { up_to: 1, stops: false });
        obey(&hand, &hand.board, (1, HandCommand::Open(0.08)));
        assert!(!hand.board.is_to_stop() && hand.calls.lock().expect("calls").is_empty());
        obey(&hand, &hand.board, (2, HandCommand::Grasp(0.0, 20.0)));
        assert_eq!(*hand.calls.lock().expect("calls"), ["grasp"]);
    }
}
