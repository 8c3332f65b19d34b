//! The session: which message has which answer.
//!
//! ```text
//! waiting --initialize--> running --shutdown--> ended --exit--> (the process ends)
//! ```
//!
//! A request that cannot be answered gets an error with its reason; a notification that makes no sense is told to the
//! user as a message of the editor. Neither ends the session.

mod capabilities;
mod news;
mod publish;
mod questions;

use std::collections::{BTreeMap, BTreeSet};

use lsp_server::{ErrorCode, Message, Notification, Request, RequestId, Response};
use lsp_types::notification as notify;
use lsp_types::notification::Notification as _;
use lsp_types::request as ask;
use lsp_types::request::Request as _;
use lsp_types::{
    InitializeParams, InitializeResult, MessageType, PublishDiagnosticsParams, ServerInfo,
    ShowMessageParams,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::End;
use crate::analysis::Analysis;
use crate::documents::Documents;
use crate::uri::Name;
use crate::workspace::{Project, Workspace};

/// What follows a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The next one.
    Next,
    /// The end.
    Exit(End),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Waiting,
    Running,
    Ended,
}

/// Why a request has no result.
struct Refused {
    code: ErrorCode,
    message: String,
}

impl Refused {
    fn parameters(message: impl ToString) -> Self {
        Self { code: ErrorCode::InvalidParams, message: message.to_string() }
    }

    fn failed(message: impl ToString) -> Self {
        Self { code: ErrorCode::RequestFailed, message: message.to_string() }
    }
}

type Answer = Result<Value, Refused>;

/// What the client said that it can do.
#[derive(Clone, Copy, Debug, Default)]
struct Client {
    /// Refuses changes of texts that are not as the server knows them.
    versioned_changes: bool,
    /// Tells of changes on the disk if it is asked to.
    watches: bool,
}

/// A session with one client.
#[derive(Debug)]
pub struct Server {
    state: State,
    client: Client,
    workspace: Workspace,
    documents: Documents,
    /// Projects as they were read last; those that have changed since are left out.
    analyses: BTreeMap<Project, Analysis>,
    /// Projects whose messages the client has not seen yet.
    waiting: BTreeSet<Project>,
    /// The messages that the client has, by project and text.
    published: BTreeMap<Project, BTreeMap<String, PublishDiagnosticsParams>>,
    /// The last problem that was told of each project.
    problems: BTreeMap<Project, String>,
    out: Vec<Message>,
}

impl Default for Server {
    fn default() -> Self {
        Self::new()
    }
}

impl Server {
    /// A session that has not begun.
    #[must_use]
    pub fn new() -> Self {
        Self {
            state: State::Waiting,
            client: Client::default(),
            workspace: Workspace::default(),
            documents: Documents::default(),
            analyses: BTreeMap::new(),
            waiting: BTreeSet::new(),
            published: BTreeMap::new(),
            problems: BTreeMap::new(),
            out: Vec::new(),
        }
    }

    /// Takes the next message of the client.
    pub fn take(&mut self, message: Message) -> Step {
        match message {
            Message::Request(request) => {
                let Request { id, method, params } = request;
                let answer = self.request(&method, params);
                self.respond(id, answer);
            }
            Message::Notification(one) if one.method == notify::Exit::METHOD => {
                let asked = self.state == State::Ended;
                return Step::Exit(if asked { End::Asked } else { End::Abrupt });
            }
            Message::Notification(one) => {
                if self.state == State::Running
                    && let Err(message) = self.notification(&one.method, one.params)
                {
                    self.show(&message);
                }
            }
            // The only request of this server registers for changes on the disk, which a client may refuse.
            Message::Response(_) => {}
        }
        Step::Next
    }

    /// What is to be sent at once.
    pub fn sent(&mut self) -> Vec<Message> {
        std::mem::take(&mut self.out)
    }

    /// What is left to do, and to be sent, when no message waits: the checks of what has changed.
    pub fn rest(&mut self) -> Vec<Message> {
        while let Some(project) = self.waiting.pop_first() {
            self.publish(&project);
        }
        self.sent()
    }

    fn respond(&mut self, id: RequestId, answer: Answer) {
        let response = match answer {
            Ok(result) => Response::new_ok(id, result),
            Err(Refused { code, message }) => Response::new_err(id, code as i32, message),
        };
        self.out.push(response.into());
    }

    fn notify<N: notify::Notification<Params: Serialize>>(&mut self, params: &N::Params) {
        let params = serde_json::to_value(params).unwrap_or(Value::Null);
        self.out.push(Notification { method: N::METHOD.to_owned(), params }.into());
    }

    fn show(&mut self, message: &str) {
        let (typ, message) = (MessageType::ERROR, format!("takt plc lsp: {message}"));
        self.notify::<notify::ShowMessage>(&ShowMessageParams { typ, message });
    }

    fn request(&mut self, method: &str, params: Value) -> Answer {
        match (self.state, method) {
            (State::Waiting, ask::Initialize::METHOD) => self.initialize(params),
            (State::Waiting, _) => Err(Refused {
                code: ErrorCode::ServerNotInitialized,
                message: format!("`{method}` before `initialize`"),
            }),
            (State::Ended, _) | (_, ask::Initialize::METHOD) => Err(Refused {
                code: ErrorCode::InvalidRequest,
                message: format!("`{method}` cannot come at this point of a session"),
            }),
            (State::Running, ask::Shutdown::METHOD) => {
                self.state = State::Ended;
                self.waiting.clear();
                Ok(Value::Null)
            }
            (State::Running, _) => self.answer(method, params),
        }
    }

    fn initialize(&mut self, params: Value) -> Answer {
        let params: InitializeParams = read(params)?;
        let workspace = params.capabilities.workspace.unwrap_or_default();
        self.client = Client {
            versioned_changes: workspace
                .workspace_edit
                .and_then(|edit| edit.document_changes)
                .unwrap_or(false),
            watches: workspace
                .did_change_watched_files
                .and_then(|watched| watched.dynamic_registration)
                .unwrap_or(false),
        };
        for folder in params.workspace_folders.unwrap_or_default() {
            self.workspace.add(&Name::new(&folder.uri));
        }
        // Clients that are older than folders have one of these.
        #[allow(deprecated)]
        if self.workspace.projects().next().is_none()
            && let Some(root) = params.root_uri
        {
            self.workspace.add(&Name::new(&root));
        }
        self.state = State::Running;
        written(InitializeResult {
            capabilities: capabilities::all(),
            server_info: Some(ServerInfo {
                name: "takt plc lsp".to_owned(),
                version: Some(env!("CARGO_PKG_VERSION").to_owned()),
            }),
        })
    }
}

fn read<P: DeserializeOwned>(params: Value) -> Result<P, Refused> {
    serde_json::from_value(params).map_err(Refused::parameters)
}

fn written(result: impl Serialize) -> Answer {
    serde_json::to_value(result).map_err(Refused::failed)
}
