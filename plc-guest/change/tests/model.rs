//! Random programs and random edits of them: a plan does what a model does that knows names and values only.

mod common;

use common::model::{expected, random_state, values};
use common::{Random, Source, TestMemory, Ty};
use takt_change::make::{Change, Refusal};
use takt_change::{Plan, Ready};
use takt_program::Image;

/// In a build without optimisation a case takes twenty times as long.
const CASES: u64 = if cfg!(debug_assertions) { 4_000 } else { 100_000 };

#[test]
fn a_plan_does_what_a_model_by_names_does_and_the_way_back_too() {
    let (mut planned, mut moved, mut converted, mut references, mut early) = (0, 0, 0, 0, 0);
    for seed in 1..=CASES {
        let random = &mut Random::new(seed);
        let mut serial = 0;
        let old = Source::random(random, &mut serial);
        let mut new = old.edited(random, &mut serial);
        if random.one_in(3) {
            new = new.edited(random, &mut serial);
        }
        let initial = random_state(random, &new, false);
        let old_initial = random_state(random, &old, false);
        let (old_file, new_file) = (old.image(&old_initial), new.image(&initial));
        let (a, b) = (Image::parse(&old_file).unwrap(), Image::parse(&new_file).unwrap());
        let change = Change::between(&a, &b);
        let Some(plans) = &change.plans else {
            for refusal in &change.refusals {
                // A reference to a type that has changed; elementary targets never do.
                assert!(
                    matches!(refusal, Refusal::Reference { .. } | Refusal::Cost { .. }),
                    "seed {seed}: {refusal}"
                );
            }
            continue;
        };
        planned += 1;
        let state = random_state(random, &old, true);
        let bytes = a.state_bytes().max(b.state_bytes());
        let mut memory = TestMemory::new(&state, bytes, &b);
        let plan = Plan::parse(&plans.forward, &a, &b).unwrap();
        let ready = Ready::new(plan);
        let mut done = Some(0);
        while let Some(now) = done {
            done = ready.prepare(now, 1 + random.below(9), &mut memory);
        }
        assert_eq!(
            &memory.state[..state.len()],
            &state[..],
            "seed {seed}: too early\n{old:?}\n{new:?}"
        );
        ready.apply(&mut memory);
        let found = values(&new, &memory.state);
        let wanted = expected(&old, &state, &new, &initial);
        assert_eq!(found, wanted, "seed {seed}\n{old:?}\n{new:?}");

        // The new version computes, and then the way is back.
        let during = random_state(random, &new, true);
        for ((_, ty), at) in new.0.iter().zip(Ty::places(&new.0)) {
            let range = at as usize..(at + ty.bytes()) as usize;
            memory.state[range.clone()].copy_from_slice(&during[range]);
        }
        memory.initial = old_initial.clone();
        memory.initial.resize(a.state_bytes() as usize, 0);
        let back = Plan::parse(&plans.back, &b, &a).unwrap();
        Ready::new(back).apply(&mut memory);
        let found = values(&old, &memory.state);
        let wanted = expected(&new, &during, &old, &state);
        assert_eq!(found, wanted, "seed {seed}, back\n{old:?}\n{new:?}");

        let cost = plan.cost();
        moved += u64::from(cost.moved > 0);
        converted += u64::from(cost.converted > 0);
        references += u64::from(cost.references > 0);
        early += u64::from(cost.early > 0);
    }
    // The cases are what they are meant to be.
    assert!(planned > CASES * 8 / 10, "{planned}");
    for count in [moved, converted, references, early] {
        assert!(count > CASES / 50, "{moved} {converted} {references} {early}");
    }
}
