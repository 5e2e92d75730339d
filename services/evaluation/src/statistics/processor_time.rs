//! Processor time of a thread: what a computation costs, whatever else the machine does meanwhile.

/// Processor time of this thread so far, milliseconds; none where the operating system does not tell (only Linux does).
pub fn of_this_thread_ms() -> Option<f64> {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    told.split_whitespace().next()?.parse::<f64>().ok().map(|ns| ns / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_on_while_the_thread_computes() {
        let Some(before_ms) = of_this_thread_ms() else { return };
        let mut sum = 0u64;
        while of_this_thread_ms().is_some_and(|now_ms| now_ms < before_ms + 5.0) {
            sum = std::hint::black_box(sum.wrapping_add(1));
        }
        assert!(sum > 0);
    }
}
