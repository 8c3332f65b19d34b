//! The page shows what is really said.

use std::collections::BTreeSet;

use serde_json::{Deserializer, Value};

use super::super::protocol::{Answer, Message, Request};

/// All JSON values in the page's blocks of that kind.
fn examples() -> Vec<Value> {
    let page = std::fs::read_to_string("../docs/control.md").unwrap();
    let blocks = page.split("```json\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    blocks
        .flat_map(|b| Deserializer::from_str(b).into_iter::<Value>().map(Result::unwrap))
        .collect()
}

#[test]
fn every_example_is_what_is_really_said() {
    let mut seen = BTreeSet::new();
    for example in examples() {
        let bytes = serde_json::to_vec(&example).unwrap();
        if let Some(request) = example["request"].as_str() {
            seen.insert(format!("request {request}"));
            let line = Request::parse(&bytes).unwrap().line();
            assert_eq!(serde_json::from_slice::<Value>(&line).unwrap(), example);
        } else {
            seen.insert(format!("answer {}", example["answer"].as_str().unwrap()));
            let message: Message = serde_json::from_value(example.clone()).unwrap();
            assert_eq!(serde_json::to_value(message).unwrap(), example);
        }
    }
    let requests = [
        "ping",
        "status",
        "stop",
        "start",
        "restart",
        "schedule",
        "events",
        "trace",
        "watch",
        "write",
        "force",
        "release",
        "load",
        "commit",
        "roll-back",
        "versions",
        "attach",
        "type",
    ];
    let answers = [
        "status", "done", "events", "event", "trace", "window", "switch", "traced", "error",
        "watching", "values", "versions", "attached", "console", "typed",
    ];
    let all = requests.map(|r| format!("request {r}")).into_iter();
    let all: BTreeSet<String> = all.chain(answers.map(|a| format!("answer {a}"))).collect();
    assert_eq!(seen, all);
}

#[test]
fn the_status_of_the_page_is_that_of_the_tests() {
    let status = Answer::Status { status: Box::new(super::status()) }.line();
    let status: Value = serde_json::from_slice(&status).unwrap();
    let shown = examples().into_iter().find(|e| e["answer"] == "status").unwrap();
    assert_eq!(shown, status, "{}", serde_json::to_string_pretty(&status).unwrap());
}
