//! How many files a process may have open. A router has one for each session over TCP, and a process's limit is 1024 at first on Linux: fewer than
//! `[session] max_sessions`.

/// Raises this process's limit to the highest that the system allows it. Where that is refused, everything stays as it is.
pub(crate) fn allow_most() {
    #[cfg(unix)]
    if let Some(limit) = limit() {
        let raised = libc::rlimit { rlim_cur: limit.rlim_max, ..limit };
        // SAFETY: the system reads a structure that lives until the call returns.
        let _refused = unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &raw const raised) };
    }
}

/// What the process may have now, and at most.
#[cfg(unix)]
fn limit() -> Option<libc::rlimit> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the system writes a structure that lives until the call returns.
    let status = unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &raw mut limit) };
    (status == 0).then_some(limit)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_process_may_have_as_many_files_as_it_is_let() {
        let before = limit().expect("a limit");
        let lowered = libc::rlimit { rlim_cur: before.rlim_max.min(512), ..before };
        // SAFETY: the system reads a structure that lives until the call returns.
        assert_eq!(unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &raw const lowered) }, 0);
        allow_most();
        assert_eq!(limit().map(|limit| limit.rlim_cur), Some(before.rlim_max));
    }
}
