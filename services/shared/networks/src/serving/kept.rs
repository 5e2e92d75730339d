//! The last few results of something costly, by what they are of.

use std::sync::{Arc, Mutex, PoisonError};

/// Keys and results, newest last.
type Entries<K, V> = Vec<(K, Arc<V>)>;

/// The last few results; clones share them.
#[derive(Debug)]
pub(super) struct Kept<K, V, const MOST: usize>(Arc<Mutex<Entries<K, V>>>);

impl<K, V, const MOST: usize> Clone for Kept<K, V, MOST> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<K, V, const MOST: usize> Default for Kept<K, V, MOST> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<K: PartialEq, V, const MOST: usize> Kept<K, V, MOST> {
    /// The result of a key, made at the first call.
    pub fn of<E>(&self, key: K, make: impl FnOnce() -> Result<V, E>) -> Result<Arc<V>, E> {
        // Held while it is made: concurrent threads would all make the same.
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, value)) = kept.iter().find(|(of, _)| *of == key) {
            return Ok(Arc::clone(value));
        }
        let value = Arc::new(make()?);
        if kept.len() == MOST {
            kept.remove(0);
        }
        kept.push((key, Arc::clone(&value)));
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_is_made_once_while_it_is_kept_and_errors_are_not_kept() {
        let kept = Kept::<u16, u16, 2>::default();
        let made = std::cell::Cell::new(0);
        let of = |key: u16| {
            kept.clone().of(key, || {
                made.set(made.get() + 1);
                if key == 9 { Err("nine") } else { Ok(10 * key) }
            })
        };
        assert_eq!([1, 2, 1, 2].map(|key| *of(key).unwrap()), [10, 20, 10, 20]);
        assert_eq!(made.get(), 2);
        assert_eq!([of(9), of(9)], [Err("nine"), Err("nine")]);
        assert_eq!(made.get(), 4);
        assert_eq!([3, 1].map(|key| *of(key).unwrap()), [30, 10]);
        assert_eq!(made.get(), 6, "the first was given up for the third");
    }
}
