//! What was made of a scene for earlier requests. A scene keeps it and knows nothing of what it is: those who make it know the scene.

use std::any::Any;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A key of some type, and what is kept by it.
type Entry = (Box<dyn Any + Send>, Arc<dyn Any + Send + Sync>);

/// Values by keys of any type, the oldest first.
#[derive(Default)]
pub struct Kept(Mutex<Vec<Entry>>);

impl fmt::Debug for Kept {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Kept({} values)", self.entries().len())
    }
}

impl Kept {
    /// The value of a key, made where it is not kept. Of keys of one type `most` are kept; the oldest goes. Nobody waits for another's: two that come at
    /// once make it twice.
    ///
    /// # Errors
    /// Those of `make`, which are not kept.
    pub fn of<K, V, E>(&self, most: usize, key: K, make: impl FnOnce() -> Result<V, E>) -> Result<Arc<V>, E>
    where
        K: PartialEq + Send + 'static,
        V: Send + Sync + 'static,
    {
        if let Some(value) = self.get(&key) {
            return Ok(value);
        }
        let value = Arc::new(make()?);
        let mut entries = self.entries();
        let of_kind = |(key, _): &Entry| key.is::<K>();
        if entries.iter().filter(|entry| of_kind(entry)).count() >= most.max(1)
            && let Some(oldest) = entries.iter().position(of_kind)
        {
            entries.remove(oldest);
        }
        entries.push((Box::new(key), value.clone()));
        Ok(value)
    }

    fn get<K: PartialEq + 'static, V: Send + Sync + 'static>(&self, key: &K) -> Option<Arc<V>> {
        let entries = self.entries();
        let (_, value) = entries.iter().find(|(of, _)| of.downcast_ref::<K>() == Some(key))?;
        value.clone().downcast().ok()
    }

    fn entries(&self) -> MutexGuard<'_, Vec<Entry>> {
        // Every change leaves it whole, so a panic elsewhere under the lock does not spoil it.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_made_once_while_they_are_kept_and_keys_of_other_types_are_others() {
        let kept = Kept::default();
        let of = |key: u16| kept.of(2, key, || if key == 9 { Err("nine") } else { Ok(u32::from(key) * 10) });
        let first = of(1).unwrap();
        assert!(Arc::ptr_eq(&first, &of(1).unwrap()) && *of(2).unwrap() == 20);
        assert_eq!(of(9), Err("nine"));
        assert_eq!(*kept.of::<_, _, ()>(1, "1", || Ok("another")).unwrap(), "another");
        assert!(Arc::ptr_eq(&first, &of(1).unwrap()), "another type takes no place of this one");
        of(3).unwrap();
        assert!(!Arc::ptr_eq(&first, &of(1).unwrap()), "given up for newer ones");
    }
}
