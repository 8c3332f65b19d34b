//! What each command does.

use std::io::{self, Write};
use std::thread;

use takt_port::channel::{ReadError, ReceiveError, ReturnCode, Tsc, Validity};
use takt_port::{CallError, Input, Kind, POLL_INTERVAL, Ports, Receiver, Start, Timeout};

use crate::arguments::{Arguments, Command, Incoming, Outgoing};
use crate::failure::Failure;
use crate::format::Message;
use crate::overview;

/// Carries the command out.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let ports = match &arguments.function {
        Some(folder) => Ports::open(folder)?,
        None => Ports::discover()?,
    };
    match &arguments.command {
        Command::List { json } => overview::list(&ports, *json),
        Command::Status { port, json } => overview::status(&ports, port.as_deref(), *json),
        Command::Write(outgoing) => write(&ports, outgoing),
        Command::Send(outgoing) => send(&ports, outgoing),
        Command::Read(incoming) => Source::sampling(&ports, incoming)?.show(&ports, incoming),
        Command::Recv(incoming) => Source::queuing(&ports, incoming)?.show(&ports, incoming),
        Command::Watch(incoming) => match ports.port(&incoming.port)?.kind {
            Kind::Sampling { .. } => Source::sampling(&ports, incoming)?,
            Kind::Queuing { .. } => Source::queuing(&ports, incoming)?,
        }
        .watch(&ports, incoming),
    }
}

fn start(open: bool) -> Start {
    if open { Start::Open } else { Start::Attach }
}

fn failed(port: &str) -> impl Fn(CallError) -> Failure {
    move |error| Failure::Call { port: port.to_owned(), error }
}

fn write(ports: &Ports, options: &Outgoing) -> Result<(), Failure> {
    let mut output = ports.output(&options.port, start(options.open))?;
    options.shape.take(options.data.as_deref(), options.count, io::stdin().lock(), |bytes| {
        output.write(bytes).map_err(|error| failed(&options.port)(error.into()))
    })
}

fn send(ports: &Ports, options: &Outgoing) -> Result<(), Failure> {
    let mut sender = ports.sender(&options.port, start(options.open))?;
    options.shape.take(options.data.as_deref(), options.count, io::stdin().lock(), |bytes| {
        sender.send(bytes, options.timeout).map_err(failed(&options.port))
    })
}

/// Where messages come from.
enum Source<'p> {
    /// With the stamp of the last sample that was shown.
    Sampling(Input<'p>, Option<Tsc>),
    Queuing(Receiver<'p>),
}

impl<'p> Source<'p> {
    fn sampling(ports: &'p Ports, options: &Incoming) -> Result<Self, Failure> {
        Ok(Self::Sampling(ports.input(&options.port, start(options.open))?, None))
    }

    fn queuing(ports: &'p Ports, options: &Incoming) -> Result<Self, Failure> {
        Ok(Self::Queuing(ports.receiver(&options.port, start(options.open))?))
    }

    /// Shows so many messages; the first failure is the end.
    fn show(mut self, ports: &Ports, options: &Incoming) -> Result<(), Failure> {
        let mut buffer = buffer(ports, options)?;
        let timeout = options.timeout.unwrap_or(Timeout::Zero);
        (0..options.count.unwrap_or(1)).try_for_each(|_| {
            let message = self.next(ports, options, &mut buffer, timeout);
            options.shape.show(&message.map_err(failed(&options.port))?, &mut io::stdout().lock())
        })
    }

    /// Shows what comes, whatever a peer that cannot be believed does in between. Messages that cannot be shown count,
    /// and are a failure at the end.
    fn watch(mut self, ports: &Ports, options: &Incoming) -> Result<(), Failure> {
        let mut buffer = buffer(ports, options)?;
        let timeout = options.timeout.unwrap_or(Timeout::Forever);
        let mut left = options.count.unwrap_or(u64::MAX);
        let mut unshown = 0;
        while left > 0 {
            match self.next(ports, options, &mut buffer, timeout) {
                Ok(message) => {
                    match options.shape.show(&message, &mut io::stdout().lock()) {
                        // The next one may be of the layout.
                        Err(failure @ Failure::Shape(_)) => {
                            complain(&failure);
                            unshown += 1;
                        }
                        shown => shown?,
                    }
                    left -= 1;
                }
                Err(
                    error @ (CallError::Read(ReadError::Unstable | ReadError::Hostile(_))
                    | CallError::Receive(ReceiveError::Unstable | ReceiveError::Hostile(_))),
                ) => {
                    complain(&failed(&options.port)(error));
                    // It may go on lying at once.
                    thread::sleep(POLL_INTERVAL);
                }
                Err(error) => return Err(failed(&options.port)(error)),
            }
        }
        match unshown {
            0 => Ok(()),
            count => Err(Failure::Unshown { port: options.port.clone(), count }),
        }
    }

    fn next<'a>(
        &mut self,
        ports: &Ports,
        options: &'a Incoming,
        buffer: &'a mut [u8],
        timeout: Timeout,
    ) -> Result<Message<'a>, CallError> {
        let (port, clock) = (options.port.as_str(), ports.clock());
        match self {
            Self::Sampling(input, known) => {
                let sample = input.read_newer(buffer, *known, timeout)?;
                *known = Some(sample.stamp);
                let age_ns = clock.nanoseconds(sample.age);
                let valid = Some(sample.validity == Validity::Valid);
                Ok(Message { port, code: 0, age_ns, valid, bytes: sample.bytes })
            }
            Self::Queuing(receiver) => {
                let received = receiver.receive(buffer, timeout)?;
                if received.code() != ReturnCode::NoError {
                    let _ = writeln!(
                        io::stderr(),
                        "takt-port: {port}: messages before this one were overwritten"
                    );
                }
                let age_ns = clock.nanoseconds(clock.now().since(received.stamp));
                let code = received.code() as u32;
                Ok(Message { port, code, age_ns, valid: None, bytes: received.bytes })
            }
        }
    }
}

/// Says what is wrong, and goes on: without a reader of the complaints the messages still count.
fn complain(failure: &Failure) {
    let _ = writeln!(io::stderr(), "takt-port: {failure}");
}

/// Room for the longest message of the port.
fn buffer(ports: &Ports, options: &Incoming) -> Result<Vec<u8>, Failure> {
    Ok(vec![0; ports.port(&options.port)?.maximum as usize])
}
