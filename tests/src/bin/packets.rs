//! Sends what comes back, floods, and serves both: for the two ends of a network interface.
//!
//!     packets serve                     echoes on TCP and UDP port 7 until it is killed; says "serving"
//!     packets tcp ADDRESS BYTES         sends so many bytes to such a server, and compares what comes back
//!     packets udp ADDRESS COUNT         as many datagrams, one after the other; those lost are sent again
//!     packets flood ADDRESS COUNT       as many datagrams as fast as they can be sent, to port 9, which is closed
//!
//! Exit status 0: what came back was right.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use takt_tests::random::Random;

const ECHO: u16 = 7;
const DISCARD: u16 = 9;
/// Longer than an answer takes in any lab, shorter than a test has patience.
const PATIENCE: Duration = Duration::from_secs(2);
/// Times that a datagram is sent.
const TRIES: usize = 10;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words[..] {
        ["serve"] => serve(),
        [what, address, count] => match (address.parse(), count.parse()) {
            (Ok(address), Ok(count)) => client(what, address, count),
            _ => Err(io::Error::other("no address or no number")),
        },
        _ => Err(io::Error::other("see the head of packets.rs")),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("packets: {words:?}: {error}");
            ExitCode::FAILURE
        }
    }
}

fn client(what: &str, address: Ipv4Addr, count: usize) -> io::Result<()> {
    match what {
        "tcp" => tcp((address, ECHO).into(), count),
        "udp" => udp((address, ECHO).into(), count),
        "flood" => flood((address, DISCARD).into(), count),
        _ => Err(io::Error::other("tcp, udp or flood")),
    }
}

fn serve() -> io::Result<()> {
    let any = (Ipv4Addr::UNSPECIFIED, ECHO);
    let (listener, socket) = (TcpListener::bind(any)?, UdpSocket::bind(any)?);
    println!("serving");
    thread::spawn(move || {
        let mut datagram = [0; 2048];
        // An answer that cannot be sent is one that the client asks for again.
        while let Ok((length, from)) = socket.recv_from(&mut datagram) {
            let _ = socket.send_to(&datagram[..length], from);
        }
    });
    for client in listener.incoming() {
        let mut client = client?;
        thread::spawn(move || io::copy(&mut client.try_clone()?, &mut client));
    }
    Ok(())
}

fn tcp(server: SocketAddr, bytes: usize) -> io::Result<()> {
    let mut random = Random::new(bytes as u64);
    let noise: Vec<u8> = (0..bytes).map(|_| random.number() as u8).collect();
    let mut stream = TcpStream::connect(server)?;
    let mut sender = stream.try_clone()?;
    let sent = noise.clone();
    let sender = thread::spawn(move || sender.write_all(&sent));
    let mut back = vec![0; bytes];
    stream.read_exact(&mut back)?;
    sender.join().map_err(|_| io::Error::other("the sender died"))??;
    if back == noise { Ok(()) } else { Err(io::Error::other("other bytes came back")) }
}

fn udp(server: SocketAddr, count: usize) -> io::Result<()> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.connect(server)?;
    socket.set_read_timeout(Some(PATIENCE))?;
    let mut random = Random::new(count as u64);
    for number in 0..count as u64 {
        // Up to what an Ethernet packet holds.
        let length = 8 + random.below(1465) as usize;
        let mut datagram = vec![number as u8; length];
        datagram[..8].copy_from_slice(&number.to_le_bytes());
        echo(&socket, &datagram)?;
    }
    Ok(())
}

/// Sends a datagram until it comes back. What comes back late was sent before.
fn echo(socket: &UdpSocket, datagram: &[u8]) -> io::Result<()> {
    let mut back = [0; 2048];
    for _ in 0..TRIES {
        socket.send(datagram)?;
        loop {
            match socket.recv(&mut back) {
                Ok(length) if back[..length] == *datagram => return Ok(()),
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock) => break,
                Err(error) => return Err(error),
            }
        }
    }
    Err(io::Error::other("a datagram never came back"))
}

fn flood(target: SocketAddr, count: usize) -> io::Result<()> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    for number in 0..count as u64 {
        // The port is closed, and the answer that says so is an error of the next call.
        let _ = socket.send_to(&number.to_le_bytes(), target);
    }
    Ok(())
}
