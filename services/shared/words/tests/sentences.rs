//! What the tables of sentences say: how many are understood, how many wrongly, how many unclear ones refused with the objects named; and
//! that none is misread which comes close to another meaning.

mod common;

use repose_proto::GoalTerm;
use repose_words::{Understood, find, looks_of, names_by_number, understand};

fn is_meant(understood: &Understood, query: u16, terms: &[String]) -> bool {
    let meant: Vec<GoalTerm> = terms.iter().map(|t| t.parse().expect("a term")).collect();
    understood.query == query && meant.iter().all(|t| understood.goal.contains(t)) && understood.goal.iter().all(|t| meant.contains(t))
}

#[test]
fn clear_sentences_are_understood_and_seldom_wrongly() {
    let (mut right, mut wrong, mut refused) = (0, Vec::new(), Vec::new());
    for case in common::table().scene {
        let scene = common::scene(&case);
        let looks = looks_of(&scene, scene.meta.view_yaw_rad);
        for (sentence, query, terms) in &case.clear {
            match understand(sentence, &looks) {
                Ok(understood) if is_meant(&understood, *query, terms) => right += 1,
                Ok(understood) => wrong.push(format!("{}: {sentence:?} as {understood:?}", case.name)),
                Err(error) => refused.push(format!("{}: {sentence:?}: {error}", case.name)),
            }
        }
    }
    let all = right + wrong.len() + refused.len();
    println!("{right} of {all} right, {} wrong, {} refused\n{}\n{}", wrong.len(), refused.len(), wrong.join("\n"), refused.join("\n"));
    assert_eq!(all, 200);
    assert!(right * 100 >= all * 95, "{right} of {all} right:\n{}\n{}", wrong.join("\n"), refused.join("\n"));
    assert!(wrong.len() * 100 <= all, "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn unclear_sentences_are_refused_with_the_objects_in_question() {
    let (mut refused, mut taken) = (0, Vec::new());
    for case in common::table().scene {
        let scene = common::scene(&case);
        let looks = looks_of(&scene, scene.meta.view_yaw_rad);
        for (sentence, named) in &case.unclear {
            let named: Vec<u16> = if named.is_empty() { case.objects.iter().map(|o| o.id).collect() } else { named.clone() };
            match understand(sentence, &looks) {
                Err(error) if error.candidates == named => {
                    let text = error.to_string();
                    assert!(named.iter().all(|id| text.contains(&format!("object {id} "))), "{text}");
                    refused += 1;
                }
                other => taken.push(format!("{}: {sentence:?}: {other:?}", case.name)),
            }
        }
    }
    let all = refused + taken.len();
    println!("{refused} of {all} refused with the objects named\n{}", taken.join("\n"));
    assert_eq!(all, 50);
    assert!(refused * 100 >= all * 98, "{refused} of {all}:\n{}", taken.join("\n"));
}

#[test]
fn a_sentence_close_to_another_meaning_is_read_as_it_says_or_refused() {
    let mut misread = Vec::new();
    for case in common::close_calls().scene {
        let scene = common::scene(&case);
        let looks = looks_of(&scene, scene.meta.view_yaw_rad);
        for (sentence, query, terms) in &case.clear {
            match understand(sentence, &looks) {
                Ok(understood) if is_meant(&understood, *query, terms) => {}
                other => misread.push(format!("{}: {sentence:?}: {other:?}", case.name)),
            }
        }
        for (sentence, words, named) in &case.refused {
            let named: Vec<u16> = if named.is_empty() { case.objects.iter().map(|o| o.id).collect() } else { named.clone() };
            match understand(sentence, &looks) {
                Err(error) if error.candidates == named && error.to_string().contains(words) => {}
                other => misread.push(format!("{}: {sentence:?}: {other:?}", case.name)),
            }
        }
    }
    assert!(misread.is_empty(), "{}", misread.join("\n"));
}

#[test]
fn a_phrase_finds_its_object_or_names_those_in_question() {
    let table = common::table();
    let kitchen = table.scene.iter().find(|case| case.name == "kitchen").expect("the kitchen");
    let scene = common::scene(kitchen);
    let looks = looks_of(&scene, scene.meta.view_yaw_rad);
    for (phrase, id) in [("the red mug", 1), ("box", 2), ("object 4", 4), ("the tallest object", 5)] {
        assert_eq!(find(phrase, &looks), Ok(id), "{phrase}");
    }
    // Saying more than is needed is no mistake as long as it is true.
    for (phrase, id) in [
        ("the bowl right of the plate", 3),
        ("the bowl that is right of the plate", 3),
        ("the mug left of the box left of the bowl", 1),
        ("the tallest object behind the mug", 5),
        ("the mug on the left", 1),
    ] {
        assert_eq!(find(phrase, &looks), Ok(id), "{phrase}");
    }
    for (phrase, named) in [
        ("the bowl left of the plate", [3]),
        ("the bowl that is left of the plate", [3]),
        ("the red mug behind the bottle", [1]),
        ("the other mug", [1]),
    ] {
        let refused = find(phrase, &looks).expect_err(phrase);
        assert_eq!(refused.candidates, named, "{phrase}: {refused}");
    }
    let all = [1, 2, 3, 4, 5];
    for (phrase, named) in [("the thing", &all[..]), ("the objects", &all), ("the pink mug", &all), ("the gizmo", &all), ("box 1", &all)] {
        let refused = find(phrase, &looks).expect_err(phrase);
        assert_eq!(refused.candidates, named, "{phrase}: {refused}");
    }
}

#[test]
fn numbers_are_found_wherever_an_object_is_named_by_one() {
    for (text, is_named) in [
        ("put object 3 left of the box", true),
        ("put the mug near #5", true),
        ("box 2", true),
        ("put the red mug left of the box", false),
        ("the second mug from the left", false),
    ] {
        assert_eq!(names_by_number(text), is_named, "{text}");
    }
}

#[test]
fn word_salad_is_answered_quickly_and_consistently() {
    use rand::{RngExt, SeedableRng};
    let table = common::table();
    let case = &table.scene[0];
    let scene = common::scene(case);
    let looks = looks_of(&scene, scene.meta.view_yaw_rad);
    let vocabulary: Vec<&str> = case.clear.iter().flat_map(|(sentence, ..)| sentence.split(' ')).collect();
    let ids: Vec<u16> = looks.iter().map(|l| l.id).collect();
    let mut random = rand_pcg::Pcg64::seed_from_u64(7);
    let mut salads: Vec<String> = (0..3000)
        .map(|_| {
            let words: Vec<&str> = (0..random.random_range(1..70)).map(|_| vocabulary[random.random_range(0..vocabulary.len())]).collect();
            format!("put the {}", words.join(" "))
        })
        .collect();
    // What nests and repeats most.
    salads.push(format!("put the mug {}", "on the left near the mug ".repeat(16)));
    salads.push(format!("put the {} mug near the box", "second left red ".repeat(22)));
    salads.push(format!("put the mug {} the box", "not near the mug and ".repeat(18)));
    salads.push(format!("put the mug {} the box", "nearest to the mug that is left of ".repeat(10)));
    for salad in &salads {
        let started = std::time::Instant::now();
        if let Ok(understood) = understand(salad, &looks) {
            assert!(understood.goal.iter().any(|t| t.holds), "{salad}");
            assert!(understood.goal.iter().all(|t| t.anchor != understood.query && ids.contains(&t.anchor)), "{salad}");
        }
        assert!(started.elapsed().as_secs() < 5, "{:?} for {salad:?}", started.elapsed());
    }
}
