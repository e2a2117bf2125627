//! Work on all cores, with results in the order of the items.
//!
//! The parallel iterators of rayon are compiled for each closure, and the closures here once more for each family of
//! models. These functions hand rayon a `dyn` closure, so that its part is compiled once.

use std::sync::{Mutex, PoisonError};

use rayon::iter::{IntoParallelIterator, ParallelIterator};

/// Applies `work` to each item.
pub(crate) fn map<T: Send, R: Send>(items: impl IntoIterator<Item = T>, work: impl Fn(T) -> R + Sync) -> Vec<R> {
    each(items.into_iter().collect(), &work)
}

/// Applies `work` to each item, and keeps the results that there are.
pub(crate) fn filter_map<T: Send, R: Send>(
    items: impl IntoIterator<Item = T>,
    work: impl Fn(T) -> Option<R> + Sync,
) -> Vec<R> {
    each(items.into_iter().collect(), &work).into_iter().flatten().collect()
}

/// Item before its work, and the result after it.
type Slot<T, R> = Mutex<(Option<T>, Option<R>)>;

fn each<T: Send, R: Send>(items: Vec<T>, work: &(dyn Fn(T) -> R + Sync)) -> Vec<R> {
    let slots: Vec<Slot<T, R>> = items.into_iter().map(|item| Mutex::new((Some(item), None))).collect();
    indices(slots.len(), &|index| {
        let item = slots[index].lock().unwrap_or_else(PoisonError::into_inner).0.take();
        // Without the lock: a panic in the work passes to the caller, and nothing else waits for this slot.
        let result = item.map(work);
        slots[index].lock().unwrap_or_else(PoisonError::into_inner).1 = result;
    });
    slots.into_iter().filter_map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner).1).collect()
}

/// The one parallel iterator of this crate.
fn indices(count: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..count).into_par_iter().for_each(work);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_the_order_of_the_items() {
        let items: Vec<usize> = (0..1000).collect();
        assert_eq!(map(&items, |item| item * 2), items.iter().map(|item| item * 2).collect::<Vec<_>>());
        let odd = filter_map(items.clone(), |item| (item % 2 == 1).then_some(item));
        assert_eq!(odd, items.into_iter().filter(|item| item % 2 == 1).collect::<Vec<_>>());
    }

    #[test]
    fn work_may_have_parallel_work_of_its_own() {
        let sums = map(0..20u64, |outer| map(0..20, |inner| outer * inner).into_iter().sum::<u64>());
        assert_eq!(sums, (0..20).map(|outer| outer * 190).collect::<Vec<_>>());
    }
}
