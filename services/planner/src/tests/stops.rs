//! Searches that end before their time: by a deadline, a cancel, or networks that change under them.

use std::ops::ControlFlow;
use std::sync::atomic::Ordering;

use repose_proto::ErrorCode;
use repose_proto::place::{Outcome, PlaceRequest, Variant};

use crate::plan::{SearchStep, plan};
use crate::search::stop::StopReason;
use crate::tests::fake::{BESIDE, Fake, request, run, scene};

#[test]
fn a_deadline_within_a_batch_is_partial_as_one_between_two_is() {
    let prepared = scene();
    for variant in [Variant::Full, Variant::Best] {
        let wanted = PlaceRequest { count: 4, ..request(&prepared, variant, &["right_of:1"]) };
        let whole = Fake::new(&[BESIDE]);
        run(&prepared, &wanted, &whole);
        let asked = whole.scored.load(Ordering::Relaxed);
        assert!(asked > 2, "{variant}: {asked}");
        for late_after in 0..asked {
            let fake = Fake { late_after, ..Fake::new(&[BESIDE]) };
            let mut iterations = 0;
            let ended = plan(&prepared, &wanted, &fake, &mut |step| {
                iterations += u32::from(step != SearchStep::Batch);
                ControlFlow::Continue(())
            });
            match ended {
                Err(error) => assert_eq!((error.code, iterations), (ErrorCode::DeadlineExceeded, 0), "{variant}: {late_after} of {asked}"),
                Ok(partial) => {
                    assert_eq!(partial.outcome, Outcome::Partial, "{variant}: {late_after} of {asked}");
                    assert!(partial.iterations >= iterations && partial.placements.iter().all(|p| p.realism.is_some()));
                    // One iteration leaves the best so far; where networks only rank, from when they were first asked about it on.
                    assert!(iterations == 0 || !partial.placements.is_empty(), "{variant}: {late_after} of {asked}");
                }
            }
            assert_eq!(fake.scored.load(Ordering::Relaxed), late_after + 1, "{variant}: after the deadline nothing is asked");
        }
    }
}

#[test]
fn a_deadline_while_evidence_is_gathered_leaves_the_answer() {
    let prepared = scene();
    let wanted = request(&prepared, Variant::Full, &["right_of:1", "left_of:1"]);
    let whole = Fake::new(&[BESIDE]);
    let result = run(&prepared, &wanted, &whole);
    let late_after = whole.scored.load(Ordering::Relaxed) - 1;
    let late = run(&prepared, &wanted, &Fake { late_after, ..Fake::new(&[BESIDE]) });
    assert_eq!((late.outcome, &late.rejections), (Outcome::None, &result.rejections));
    assert!(result.relaxation.is_some() && late.relaxation.is_none());
}

#[test]
fn where_networks_only_rank_nothing_is_returned_that_they_were_not_asked_about() {
    // One small batch an iteration: of some seeds the first has no feasible candidate and the second some.
    let prepared = scene();
    let mut unasked = 0;
    for seed in 0..60 {
        let mut wanted = PlaceRequest { seed, ..request(&prepared, Variant::Best, &["right_of:1", "near:1"]) };
        (wanted.budget.batch, wanted.budget.draws_per_batch) = (Some(4), Some(1));
        let (mut iterations, mut batches) = (0, 0);
        let ended = plan(&prepared, &wanted, &Fake::new(&[BESIDE]), &mut |step| {
            match step {
                SearchStep::Iteration(_) => (iterations, batches) = (iterations + 1, 0),
                SearchStep::Batch => batches += 1,
            }
            if iterations == 1 && batches == 2 { ControlFlow::Break(StopReason::Deadline) } else { ControlFlow::Continue(()) }
        });
        let Ok(partial) = ended else { continue };
        assert!(partial.placements.iter().all(|p| p.realism.is_some()), "seed {seed}: {:?}", partial.placements);
        let accepted = partial.evaluated > partial.rejections.values().sum();
        unasked += usize::from(partial.outcome == Outcome::Partial && accepted && partial.placements.is_empty());
    }
    assert!(unasked > 0, "no seed had such a search");
}

#[test]
fn a_stop_at_any_batch_asks_nothing_more_and_says_what_it_is() {
    let prepared = scene();
    for variant in [Variant::Full, Variant::Best] {
        let wanted = PlaceRequest { count: 4, ..request(&prepared, variant, &["right_of:1"]) };
        let mut batches = 0;
        let whole = plan(&prepared, &wanted, &Fake::new(&[BESIDE]), &mut |step| {
            batches += usize::from(step == SearchStep::Batch);
            ControlFlow::Continue(())
        })
        .unwrap();
        for stop_at in 0..batches {
            for stop in [StopReason::Deadline, StopReason::Cancelled] {
                let fake = Fake::new(&[BESIDE]);
                let (mut seen, mut iterations, mut asked) = (0, 0, 0);
                let ended = plan(&prepared, &wanted, &fake, &mut |step| {
                    let SearchStep::Iteration(_) = step else {
                        seen += 1;
                        asked = fake.scored.load(Ordering::Relaxed);
                        return if seen > stop_at { ControlFlow::Break(stop) } else { ControlFlow::Continue(()) };
                    };
                    iterations += 1;
                    ControlFlow::Continue(())
                });
                assert_eq!(fake.scored.load(Ordering::Relaxed), asked, "{variant}: nothing is asked after the stop at batch {stop_at}");
                match (stop, iterations, ended) {
                    (StopReason::Cancelled, _, ended) => assert_eq!(ended.unwrap_err().code, ErrorCode::Cancelled),
                    (StopReason::Deadline, 0, ended) => assert_eq!(ended.unwrap_err().code, ErrorCode::DeadlineExceeded),
                    (StopReason::Deadline, _, ended) => {
                        let partial = ended.unwrap();
                        assert_eq!((partial.outcome, partial.iterations), (Outcome::Partial, iterations));
                        assert!(partial.evaluated <= whole.evaluated);
                        // What the networks were not asked about is not passed off as believed.
                        assert!(partial.placements.iter().all(|p| p.realism.is_some()), "{variant}: {:?}", partial.placements);
                    }
                }
            }
        }
        assert_eq!(whole.outcome, Outcome::Found);
        assert!(batches >= 4, "{variant}: {batches} batches");
    }
}

#[test]
fn between_two_questions_to_the_networks_a_stop_is_heard() {
    let prepared = scene();
    let mut of_ranking = 0;
    for seed in 0..6 {
        let wanted = PlaceRequest { seed, count: 6, ..request(&prepared, Variant::Best, &["right_of:1"]) };
        let fake = Fake::new(&[BESIDE]);
        let (mut asked_before, mut searched) = (Vec::new(), 0);
        plan(&prepared, &wanted, &fake, &mut |step| {
            asked_before.push(fake.scored.load(Ordering::Relaxed));
            if step != SearchStep::Batch {
                searched = asked_before.len();
            }
            ControlFlow::Continue(())
        })
        .unwrap();
        asked_before.push(fake.scored.load(Ordering::Relaxed));
        assert!(asked_before.windows(2).all(|steps| steps[1] - steps[0] <= 1), "seed {seed}: {asked_before:?}");
        of_ranking = of_ranking.max(asked_before[asked_before.len() - 1] - asked_before[searched - 1]);
    }
    assert!(of_ranking > 1, "no ranking took more than one question");
}

#[test]
fn weights_that_change_half_way_end_the_request() {
    let prepared = scene();
    let fake = Fake { changes_after: 3, ..Fake::new(&[BESIDE]) };
    let wanted = request(&prepared, Variant::Full, &["right_of:1"]);
    let error = plan(&prepared, &wanted, &fake, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!(error.code, ErrorCode::Unavailable);
}
