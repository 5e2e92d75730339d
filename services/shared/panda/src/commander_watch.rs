//! Whether the commander of a robot is still there: the rule for tasks, which every robot's side keeps.
//!
//! A task is open from the command that opens it to the one that closes it. In between its commander must be heard again before the last
//! command's time to live is over, moving or at rest, or it counts as lost. Outside a task silence at rest means nothing.

/// When the commander was last heard, and the task that it has open.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CommanderWatch {
    expires_s: f64,
    task: Option<String>,
}

impl CommanderWatch {
    /// A command was taken whose time to live ends at `expires_s` of the receiver's monotonic clock.
    pub fn take(&mut self, expires_s: f64) {
        self.expires_s = expires_s;
    }

    /// The last command was repeated: its time to live begins anew.
    pub fn repeat(&mut self, expires_s: f64) {
        self.expires_s = self.expires_s.max(expires_s);
    }

    /// Opens a task.
    pub fn open(&mut self, task: &str) {
        self.task = Some(task.to_owned());
    }

    /// Closes the open task.
    pub fn close(&mut self) {
        self.task = None;
    }

    /// The open task.
    pub fn task(&self) -> Option<&str> {
        self.task.as_deref()
    }

    /// Whether the last command has outlived its time to live.
    pub fn is_silent(&self, now_s: f64) -> bool {
        now_s > self.expires_s
    }

    /// The open task whose commander is lost: a stop has to latch.
    pub fn lost_task(&self, now_s: f64) -> Option<&str> {
        self.task().filter(|_| self.is_silent(now_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_matters_within_a_task_only_and_a_repeat_ends_it() {
        let mut watch = CommanderWatch::default();
        watch.take(0.5);
        assert_eq!((watch.is_silent(1.0), watch.lost_task(1.0)), (true, None));
        watch.open("a");
        assert_eq!((watch.lost_task(0.4), watch.lost_task(1.0)), (None, Some("a")));
        watch.repeat(1.5);
        watch.repeat(0.2);
        assert_eq!(watch.lost_task(1.0), None);
        watch.close();
        assert_eq!(watch.lost_task(9.0), None);
    }
}
