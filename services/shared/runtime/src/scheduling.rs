//! Who goes first where cores are scarce: threads that carry messages before threads that compute. A refusal, or a stop, must not wait for a core.
//!
//! A message passes a dozen threads on its way through a router and back, and each of them may find every core taken. Linux lets a thread that wakes take
//! a core at once from one that asked for longer slices than it did (6.12 and later: `sched_setattr` with a runtime for ordinary threads), and gives a
//! nicer thread less of a core that is contended. Both are an ordinary user's to ask for; where they are refused or unknown, threads stay as they are.

/// The lower priority of compute threads, on the scale of `nice`, beside that of their process.
#[cfg(target_os = "linux")]
const NICER_BY: i32 = 5;
/// What a compute thread asks to run for at a time, nanoseconds: long, so that it gives way to whoever asked for less.
#[cfg(target_os = "linux")]
const COMPUTE_SLICE_NS: u64 = 20_000_000;
/// What a thread that carries messages asks for: longer than it takes to handle one.
#[cfg(target_os = "linux")]
const MESSAGE_SLICE_NS: u64 = 300_000;

/// Has the calling thread, and those that it starts from now on, go before other threads when it wakes: for processes that carry messages, before they
/// start their threads.
pub fn prefer_messages() {
    #[cfg(target_os = "linux")]
    ask_for(0, MESSAGE_SLICE_NS);
}

/// Lets the threads that carry messages go before the calling one, and before those that it starts.
pub fn yield_to_messages() {
    #[cfg(target_os = "linux")]
    ask_for(NICER_BY, COMPUTE_SLICE_NS);
}

/// The kernel's `struct sched_attr`, in its first version.
#[cfg(target_os = "linux")]
#[repr(C)]
#[derive(Default)]
#[allow(dead_code, reason = "the kernel reads them")]
struct Attributes {
    size: u32,
    policy: u32,
    flags: u64,
    nice: i32,
    priority: u32,
    runtime_ns: u64,
    deadline_ns: u64,
    period_ns: u64,
}

/// The highest value of `nice`.
#[cfg(target_os = "linux")]
const NICEST: i32 = 19;

#[cfg(target_os = "linux")]
fn ask_for(nicer_by: i32, slice_ns: u64) {
    // SAFETY: a plain system call about the calling thread.
    let nice = unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) };
    let size = u32::try_from(size_of::<Attributes>()).unwrap_or(0);
    let attributes = Attributes { size, nice: (nice + nicer_by).min(NICEST), runtime_ns: slice_ns, ..Attributes::default() };
    // SAFETY: the kernel reads `size` bytes of a structure that lives until the call returns. Policy 0 is that of ordinary threads.
    let _refused = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, std::ptr::from_ref(&attributes), 0) };
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_compute_thread_is_nicer_than_the_one_that_started_it_and_stays_an_ordinary_one() {
        // SAFETY: a plain system call about the calling thread.
        let nice = || unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) };
        let ours = nice();
        std::thread::spawn(move || {
            yield_to_messages();
            assert_eq!(nice(), (ours + NICER_BY).min(NICEST));
            // SAFETY: a plain system call about the calling thread.
            assert_eq!(unsafe { libc::sched_getscheduler(0) }, libc::SCHED_OTHER);
            // What it starts inherits it.
            std::thread::spawn(move || assert_eq!(nice(), (ours + NICER_BY).min(NICEST))).join().expect("the inner thread");
        })
        .join()
        .expect("the thread");
        assert_eq!(nice(), ours, "and this one stays as it was");
    }
}
