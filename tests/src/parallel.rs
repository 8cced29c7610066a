//! Independent pieces of work on all processors.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

/// Does the pieces 0 to `count` - 1 on as many threads as there are processors, and hands their results on in
/// order, each one as soon as all before it are there.
///
/// # Panics
/// If a piece of work panics.
pub fn in_order<T: Send>(
    count: usize,
    work: impl Fn(usize) -> T + Sync,
    mut show: impl FnMut(usize, T),
) {
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    let begun = AtomicUsize::new(0);
    let (sender, results) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..threads.min(count) {
            let (sender, begun, work) = (sender.clone(), &begun, &work);
            scope.spawn(move || {
                loop {
                    let piece = begun.fetch_add(1, Ordering::Relaxed);
                    if piece >= count || sender.send((piece, work(piece))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        let mut waiting = BTreeMap::new();
        let mut next = 0;
        for (piece, result) in results {
            waiting.insert(piece, result);
            while let Some(result) = waiting.remove(&next) {
                show(next, result);
                next += 1;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::in_order;

    #[test]
    fn every_piece_is_done_once_and_shown_in_order() {
        let mut seen = Vec::new();
        in_order(
            100,
            |piece| piece * piece,
            |piece, square| seen.push((piece, square)),
        );
        let expected: Vec<_> = (0..100).map(|piece| (piece, piece * piece)).collect();
        assert_eq!(seen, expected);
        in_order(0, |_| unreachable!("there is no work"), |_, ()| ());
    }
}
