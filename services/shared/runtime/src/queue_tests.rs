//! What callers may rely on: order, refusal, batches, and that nothing that nobody waits for is computed.

use std::collections::BTreeMap;
use std::sync::mpsc;

use futures::FutureExt;
use repose_proto::Priority;
use tokio_util::sync::CancellationToken;

use super::*;
use crate::shares::CellShare;
use crate::waiting::LET_BY;

fn queue(capacity: usize) -> ComputeQueue {
    ComputeQueue::start(QueueSettings { capacity, ..QueueSettings::default() }).unwrap()
}

fn minute() -> JobContext {
    JobContext::within(Duration::from_secs(60))
}

/// Occupies the only thread until the returned sender is dropped.
fn block(queue: &ComputeQueue) -> (mpsc::Sender<()>, impl Future<Output = Result<(), CallError>> + '_) {
    let (release, released) = mpsc::channel::<()>();
    let running = queue.run(minute(), move |_| {
        let _released = released.recv();
        Ok(())
    });
    (release, running)
}

#[tokio::test]
async fn a_job_returns_its_value_and_its_error() {
    let queue = queue(4);
    assert_eq!(queue.run(minute(), |_| Ok(3)).await, Ok(3));
    let error = queue.run(minute(), |_| Err::<(), _>(CallError::precondition("no"))).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::FailedPrecondition);
}

/// Waits until a thread has taken a job.
async fn until_running(gauge: &LoadGauge) {
    while gauge.running() == 0 {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn a_panic_is_an_internal_error_and_the_thread_lives_on() {
    let queue = queue(4);
    let error = queue.run(minute(), |_| -> Result<(), CallError> { panic!("on purpose") }).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::Internal);
    assert_eq!(queue.run(minute(), |_| Ok(1)).await, Ok(1));
}

#[tokio::test]
async fn a_full_queue_refuses_at_once_and_says_when_to_come_back() {
    let queue = queue(1);
    let (release, running) = block(&queue);
    let mut running = std::pin::pin!(running);
    // One poll submits the blocker; wait until the thread has taken it.
    assert!(futures::poll!(running.as_mut()).is_pending());
    until_running(&queue.gauge()).await;
    let mut waiting = std::pin::pin!(queue.run(minute(), |_| Ok(())));
    assert!(futures::poll!(waiting.as_mut()).is_pending());
    let refused = queue.run(minute(), |_| Ok(())).await.unwrap_err();
    assert_eq!(refused.code, ErrorCode::ResourceExhausted);
    assert!(refused.retryable && refused.retry_after_ms.is_some());
    drop(release);
    assert_eq!((running.await, waiting.await), (Ok(()), Ok(())));
}

#[tokio::test]
async fn a_job_whose_caller_has_gone_is_never_started() {
    let queue = queue(4);
    let (release, running) = block(&queue);
    let mut running = std::pin::pin!(running);
    assert!(futures::poll!(running.as_mut()).is_pending());
    let (started, was_started) = mpsc::channel();
    {
        let mut forgotten = std::pin::pin!(queue.run(minute(), move |_| {
            let _sent = started.send(());
            Ok(())
        }));
        assert!(futures::poll!(forgotten.as_mut()).is_pending());
    }
    drop(release);
    running.await.unwrap();
    assert_eq!(queue.run(minute(), |_| Ok(5)).await, Ok(5));
    assert!(was_started.recv().is_err(), "the forgotten job ran");
}

#[tokio::test]
async fn cancelled_and_overdue_jobs_end_with_their_own_codes() {
    let queue = queue(4);
    let cancelled = CancellationToken::new();
    cancelled.cancel();
    let context = JobContext::new(Instant::now() + Duration::from_secs(9), cancelled);
    assert_eq!(queue.run(context, |_| Ok(())).await.unwrap_err().code, ErrorCode::Cancelled);
    assert_eq!(queue.run(JobContext::within(Duration::ZERO), |_| Ok(())).await.unwrap_err().code, ErrorCode::DeadlineExceeded);
}

#[tokio::test]
async fn jobs_that_wait_together_are_handed_over_together() {
    let (release, released) = mpsc::channel::<()>();
    let mut released = Some(released);
    let settings = QueueSettings { capacity: 16, max_batch: 8, ..QueueSettings::default() };
    let queue = BatchQueue::<u32, usize>::start(settings, |_| {
        let released = released.take();
        move |jobs: Vec<Job<u32, usize>>| {
            if jobs[0].request == 0 {
                let _released = released.as_ref().map(mpsc::Receiver::recv);
            }
            let size = jobs.len();
            jobs.into_iter().for_each(|job| job.finish(Ok(size)));
        }
    })
    .unwrap();
    let first = queue.submit(minute(), 0).unwrap();
    until_running(&queue.gauge()).await;
    let others: Vec<_> = (1..=5).map(|i| queue.submit(minute(), i).unwrap()).collect();
    drop(release);
    assert_eq!(first.answer().await, Ok(1));
    for other in others {
        assert_eq!(other.answer().await, Ok(5));
    }
}

/// A queue that answers each job, a number that is its weight, with how many jobs came before it and how many came with it. Its thread is
/// held by the first job, a zero, until the sender is dropped.
fn ordered(settings: QueueSettings) -> (BatchQueue<u32, (usize, usize)>, mpsc::Sender<()>) {
    let (release, released) = mpsc::channel::<()>();
    let mut released = Some(released);
    let queue = BatchQueue::start_weighed(
        settings,
        |weight| *weight as usize,
        |_| {
            let (released, mut before) = (released.take(), 0);
            move |jobs: Vec<Job<u32, (usize, usize)>>| {
                if jobs[0].request == 0 {
                    let _released = released.as_ref().map(mpsc::Receiver::recv);
                }
                let size = jobs.len();
                for job in jobs {
                    job.finish(Ok((before, size)));
                    before += 1;
                }
            }
        },
    );
    (queue.unwrap(), release)
}

#[tokio::test]
async fn interactive_jobs_go_first_and_batch_jobs_get_their_turn() {
    let (queue, release) = ordered(QueueSettings { capacity: 64, ..QueueSettings::default() });
    let first = queue.submit(minute(), 0).unwrap();
    until_running(&queue.gauge()).await;
    let batch: Vec<_> = (0..2).map(|_| queue.submit(minute().with_priority(Priority::Batch), 1).unwrap()).collect();
    let interactive: Vec<_> = (0..2 * LET_BY + 8).map(|_| queue.submit(minute(), 2).unwrap()).collect();
    drop(release);
    assert_eq!(first.answer().await.unwrap().0, 0);
    let mut places = Vec::new();
    for job in batch {
        places.push(job.answer().await.unwrap().0);
    }
    assert_eq!(places, [1 + LET_BY, 2 + 2 * LET_BY]);
    for job in interactive {
        job.answer().await.unwrap();
    }
}

#[tokio::test]
async fn a_batch_waits_for_others_as_long_as_it_may() {
    let wait = Duration::from_secs(30);
    let (queue, _release) = ordered(QueueSettings { capacity: 16, max_batch: 3, max_wait: wait, ..QueueSettings::default() });
    // Nothing holds the thread: it takes the first job and waits; the third fills the batch long before the time is over.
    let jobs: Vec<_> = (1..=3).map(|i| queue.submit(minute(), i).unwrap()).collect();
    for job in jobs {
        assert_eq!(job.answer().await.unwrap().1, 3);
    }
    let (queue, _release) = ordered(QueueSettings { max_batch: 3, max_wait: Duration::from_millis(1), ..QueueSettings::default() });
    assert_eq!(queue.submit(minute(), 1).unwrap().answer().await.unwrap().1, 1, "alone, it does not wait for ever");
}

/// What [`ordered`] answers to jobs of these requests and priorities that wait together.
async fn handed_over(settings: QueueSettings, jobs: &[(u32, Priority)]) -> Vec<(usize, usize)> {
    let (queue, release) = ordered(settings);
    let first = queue.submit(minute(), 0).unwrap();
    until_running(&queue.gauge()).await;
    let jobs: Vec<_> = jobs.iter().map(|(request, p)| queue.submit(minute().with_priority(*p), *request).unwrap()).collect();
    drop(release);
    first.answer().await.unwrap();
    let mut answers = Vec::new();
    for job in jobs {
        answers.push(job.answer().await.unwrap());
    }
    answers
}

#[tokio::test]
async fn batch_jobs_join_interactive_ones_only_when_it_is_their_turn() {
    use Priority::{Batch, Interactive};
    let settings = QueueSettings { capacity: 64, max_batch: 2 * LET_BY, ..QueueSettings::default() };
    let few = handed_over(settings.clone(), &[(1, Batch), (1, Interactive), (1, Interactive), (1, Batch)]).await;
    assert_eq!(few, [(3, 2), (1, 2), (2, 2), (4, 2)], "interactive ones first and alone, then the batch ones together");
    // The batch job that has let enough by is handed over with those that come after it, and is the last of them.
    let many: Vec<_> = std::iter::once((1, Batch)).chain(std::iter::repeat_n((1, Interactive), LET_BY + 2)).collect();
    let many = handed_over(settings, &many).await;
    assert_eq!(many[0], (LET_BY + 3, LET_BY + 3));
    assert_eq!(many[1], (1, LET_BY + 3));
}

#[tokio::test]
async fn jobs_are_handed_over_up_to_a_weight_and_a_heavier_one_alone() {
    let settings = QueueSettings { capacity: 64, max_batch: 3, max_weight: 10, ..QueueSettings::default() };
    let sizes = handed_over(settings, &[4, 6, 1, 20, 2, 2, 2, 2].map(|weight| (weight, Priority::Interactive))).await;
    assert_eq!(sizes.iter().map(|(_, size)| *size).collect::<Vec<_>>(), [2, 2, 1, 1, 3, 3, 3, 1]);
}

fn within(priority: Priority, ms: u64) -> JobContext {
    JobContext::within(Duration::from_millis(ms)).with_priority(priority)
}

/// An answer comes before its job is counted: waits until the gauge has all of them.
async fn all_counted(queue: &ComputeQueue) {
    while queue.gauge().running() > 0 {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn a_job_that_could_not_be_done_by_its_deadline_is_refused_at_once() {
    let queue = queue(64);
    // What jobs take here is known from one that took half a second.
    queue
        .run(minute(), |_| {
            std::thread::sleep(Duration::from_millis(500));
            Ok(())
        })
        .await
        .unwrap();
    all_counted(&queue).await;
    let (release, running) = block(&queue);
    let mut running = std::pin::pin!(running);
    assert!(futures::poll!(running.as_mut()).is_pending());
    until_running(&queue.gauge()).await;
    let mut waiting: Vec<_> = (0..4).map(|_| Box::pin(queue.run(minute(), |_| Ok(())))).collect();
    for job in &mut waiting {
        assert!(futures::poll!(job.as_mut()).is_pending());
    }
    let refused = queue.run(within(Priority::Interactive, 1500), |_| Ok(())).now_or_never();
    let refused = refused.expect("at once, and not at the deadline").unwrap_err();
    assert_eq!(refused.code, ErrorCode::ResourceExhausted, "{refused}");
    assert!(refused.retry_after_ms.is_some() && refused.message.contains("ms are left"), "{refused}");
    drop(release);
    running.await.unwrap();
    for job in waiting {
        job.await.unwrap();
    }
    all_counted(&queue).await;
    // An idle queue takes anything, whether or not it is in time: a smoothed time must be able to fall again.
    let ended = queue.run(within(Priority::Interactive, 100), |_| Ok(())).await;
    assert_ne!(ended.err().map(|error| error.code), Some(ErrorCode::ResourceExhausted));
}

#[tokio::test]
async fn batch_leaves_half_of_the_places_and_yields_its_own_to_interactive_jobs() {
    let queue = queue(4);
    let (release, running) = block(&queue);
    let mut running = std::pin::pin!(running);
    assert!(futures::poll!(running.as_mut()).is_pending());
    until_running(&queue.gauge()).await;
    let job = |priority| Box::pin(queue.run(within(priority, 60_000), move |_| Ok(priority)));
    let mut batch = [job(Priority::Batch), job(Priority::Batch)];
    for job in &mut batch {
        assert!(futures::poll!(job.as_mut()).is_pending());
    }
    assert_eq!(job(Priority::Batch).await.unwrap_err().code, ErrorCode::ResourceExhausted, "half of the places are batch's");
    let mut interactive: Vec<_> = (0..4).map(|_| job(Priority::Interactive)).collect();
    for job in &mut interactive {
        assert!(futures::poll!(job.as_mut()).is_pending());
    }
    let [older, younger] = batch;
    assert_eq!(younger.await.unwrap_err().code, ErrorCode::ResourceExhausted, "displaced");
    assert_eq!(older.await.unwrap_err().code, ErrorCode::ResourceExhausted, "displaced, too");
    assert_eq!(job(Priority::Interactive).await.unwrap_err().code, ErrorCode::ResourceExhausted, "no place and nothing to displace");
    drop(release);
    running.await.unwrap();
    for job in interactive {
        assert_eq!(job.await, Ok(Priority::Interactive));
    }
}

fn of_cell(cell: &str) -> JobContext {
    minute().for_cell(Some(cell.into()))
}

/// The shares of cells that each have one of their own.
fn shares<const N: usize>(cells: [(&str, CellShare); N]) -> Arc<Shares> {
    Arc::new(Shares::new(CellShare::default(), BTreeMap::from(cells.map(|(cell, share)| (cell.to_owned(), share)))))
}

/// The places in the order of computing of jobs for these cells that wait together, after the first, which holds the thread.
async fn places(settings: QueueSettings, cells: &[&str]) -> Vec<usize> {
    let (queue, release) = ordered(settings);
    let first = queue.submit(minute(), 0).unwrap();
    until_running(&queue.gauge()).await;
    let jobs: Vec<_> = cells.iter().map(|cell| queue.submit(of_cell(cell), 1).unwrap()).collect();
    drop(release);
    first.answer().await.unwrap();
    let mut places = Vec::new();
    for job in jobs {
        places.push(job.answer().await.unwrap().0);
    }
    places
}

#[tokio::test]
async fn cells_take_turns_and_one_that_floods_delays_the_others_by_one_job_each() {
    let settings = QueueSettings { capacity: 64, ..QueueSettings::default() };
    let flooded = places(settings, &["a", "a", "a", "a", "a", "a", "b", "b", "c"]).await;
    assert_eq!(flooded, [1, 4, 6, 7, 8, 9, 2, 5, 3]);
}

#[tokio::test]
async fn a_cell_of_twice_the_weight_has_two_jobs_computed_for_each_of_another() {
    let weight = CellShare { weight: Some(2.0), ..CellShare::default() };
    let settings = QueueSettings { capacity: 64, shares: shares([("a", weight)]), ..QueueSettings::default() };
    let places = places(settings, &["b", "b", "b", "a", "a", "a", "a", "a", "a"]).await;
    let before = |place: usize| places[3..].iter().filter(|other| **other < place).count();
    assert_eq!(places[..3].iter().map(|place| before(*place)).collect::<Vec<_>>(), [0, 2, 4], "{places:?}");
}

#[tokio::test]
async fn a_cell_has_no_more_jobs_waiting_and_running_than_it_may_have() {
    let limit = CellShare { max_waiting: Some(2), max_running: Some(1), ..CellShare::default() };
    let settings = QueueSettings { capacity: 64, threads: 2, shares: shares([("a", limit)]), ..QueueSettings::default() };
    let queue = ComputeQueue::start(settings).unwrap();
    let (release, released) = mpsc::channel::<()>();
    let mut running = Box::pin(queue.run(of_cell("a"), move |_| {
        let _released = released.recv();
        Ok(())
    }));
    assert!(futures::poll!(running.as_mut()).is_pending());
    until_running(&queue.gauge()).await;
    let mut waiting: Vec<_> = (0..2).map(|_| Box::pin(queue.run(of_cell("a"), |_| Ok(())))).collect();
    for job in &mut waiting {
        assert!(futures::poll!(job.as_mut()).is_pending());
    }
    let refused = queue.run(of_cell("a"), |_| Ok(())).await.unwrap_err();
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::ResourceExhausted, Some("cell")));
    assert!(refused.message.contains("cell a") && refused.retry_after_ms.is_some(), "{refused}");
    // The other thread is for other cells, and those that wait leave it to them.
    queue.run(of_cell("b"), |_| Ok(())).await.unwrap();
    assert_eq!(queue.gauge().waiting(), 2);
    drop(release);
    running.await.unwrap();
    for job in waiting {
        job.await.unwrap();
    }
}

#[tokio::test]
async fn a_job_whose_caller_has_gone_takes_no_place_of_its_cell() {
    let limit = CellShare { max_waiting: Some(1), ..CellShare::default() };
    let (queue, release) = ordered(QueueSettings { capacity: 64, shares: shares([("a", limit)]), ..QueueSettings::default() });
    let first = queue.submit(minute(), 0).unwrap();
    until_running(&queue.gauge()).await;
    drop(queue.submit(of_cell("a"), 1).unwrap());
    let waiting = queue.submit(of_cell("a"), 1).expect("the place of one that nobody waits for");
    assert_eq!(queue.submit(of_cell("a"), 1).err().map(|refused| refused.code), Some(ErrorCode::ResourceExhausted));
    drop(release);
    first.answer().await.unwrap();
    waiting.answer().await.unwrap();
}

#[tokio::test]
async fn a_cell_that_floods_finds_half_of_the_places_and_the_next_cell_finds_some() {
    let queue = queue(8);
    let (release, running) = block(&queue);
    let mut running = std::pin::pin!(running);
    assert!(futures::poll!(running.as_mut()).is_pending());
    until_running(&queue.gauge()).await;
    let mut waiting: Vec<_> = (0..4).map(|_| Box::pin(queue.run(of_cell("a"), |_| Ok(())))).collect();
    waiting.iter_mut().for_each(|job| assert!(job.as_mut().now_or_never().is_none()));
    let refused = queue.run(of_cell("a"), |_| Ok(())).await.unwrap_err();
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::ResourceExhausted, Some("cell")), "{refused}");
    let mut of_the_next = Box::pin(queue.run(of_cell("b"), |_| Ok(())));
    assert!(futures::poll!(of_the_next.as_mut()).is_pending());
    drop(release);
    running.await.unwrap();
    of_the_next.await.unwrap();
    for job in waiting {
        job.await.unwrap();
    }
}

#[tokio::test]
async fn a_cell_pays_for_what_was_computed_and_not_for_what_it_gave_up() {
    let (queue, release) = ordered(QueueSettings { capacity: 64, ..QueueSettings::default() });
    let first = queue.submit(minute(), 0).unwrap();
    until_running(&queue.gauge()).await;
    drop((0..5).map(|_| queue.submit(of_cell("a"), 1).unwrap()).collect::<Vec<_>>());
    let of_b: Vec<_> = (0..3).map(|_| queue.submit(of_cell("b"), 1).unwrap()).collect();
    let of_a = queue.submit(of_cell("a"), 1).unwrap();
    drop(release);
    first.answer().await.unwrap();
    assert!(of_a.answer().await.unwrap().0 <= 2);
    for job in of_b {
        job.answer().await.unwrap();
    }
}
