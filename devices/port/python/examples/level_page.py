#!/usr/bin/env python3
"""Shows the level that the PLC publishes on a page, live, and lets an operator hold another level.

    level_page.py [--address 127.0.0.1] [--http-port 8080] [--operate]

One thread owns the ports: it reads `level`, and renews `setpoint` while a page asks for it. Each browser has a thread of its
own, and gets copies. Without --operate the page only shows. There is no login: every user who reaches the address
has the page.
"""

import argparse
import http.server
import io
import ipaddress
import json
import math
import pathlib
import secrets
import socket
import socketserver
import struct
import threading
import time
from urllib.parse import urlsplit

import takt_port

LOWEST, HIGHEST = 0.0, 2.0  # metres: what an operator may ask for; the tank runs over at 3
PERIOD_S = 0.1  # between two looks at the level
HOLD_S = 5.0  # a page that has not renewed its setpoint for so long has lost it
STILL_S = 1.0  # a look at the ports that is older says nothing about now
BROWSERS = 16  # connections at once; a further one is closed
REQUEST_S, REQUEST_BYTES = 5.0, 8192  # how long a request may take, and how long it may be
UNREAD_S = 5.0  # a browser that takes nothing for so long is given up
UNREAD_BYTES = 8192  # about the events that wait for it until then

PAGE = pathlib.Path(__file__).with_name("level_page.html")


class Refused(Exception):
    """What was asked for is not done: the status of HTTP, and why."""


class Plant:
    """What is known of the level, and who holds it. Its methods may be called in any thread."""

    def __init__(self, clock=time.monotonic):
        self._clock = clock
        self._changed = threading.Condition()
        self._looks = 0
        self._looked = -math.inf
        self._level = (None, None, "the ports have not been read yet")
        self._holder, self._setpoint, self._held_until = None, None, -math.inf

    def tell(self, metres, age, why_not):
        """Publishes what a look at the port has brought. A level is good if there is nothing in why_not."""
        with self._changed:
            self._looks += 1
            self._looked = self._clock()
            self._level = (metres, age, why_not)
            self._changed.notify_all()

    def wait(self, looks, timeout):
        """Waits for another look than these. Their number, and what a page is to show."""
        with self._changed:
            self._changed.wait_for(lambda: self._looks != looks, timeout)
            now = self._clock()
            metres, age, why_not = self._level
            since = now - self._looked
            if since > STILL_S:
                why_not = why_not or "the ports are not read any more"
            shown = {
                "at": round(now, 3),
                "level": metres,
                "age": None if age is None else round(age + since, 4),
                "problem": why_not,
                "setpoint": self._setpoint if now < self._held_until else None,
            }
            return self._looks, shown

    def hold(self, metres):
        """Takes a setpoint from an operator. What the page needs to renew it; the one before is void."""
        # A bool is an int to Python, and a NaN compares with nothing.
        if isinstance(metres, bool) or not isinstance(metres, (int, float)) or not LOWEST <= metres <= HIGHEST:
            raise Refused(400, f"a setpoint is a number from {LOWEST} to {HIGHEST} m")
        with self._changed:
            self._holder, self._setpoint = secrets.token_hex(8), float(metres)
            self._held_until = self._clock() + HOLD_S
            return self._holder

    def renew(self, holder, release=False):
        """Keeps the setpoint of this page, or gives it up."""
        with self._changed:
            now = self._clock()
            if now >= self._held_until or holder != self._holder:
                raise Refused(409, "this page does not hold the level any more")
            self._held_until = now if release else now + HOLD_S

    def held(self):
        """The setpoint that the PLC is to be told now, if any."""
        with self._changed:
            return self._setpoint if self._clock() < self._held_until else None


def look(plant, level):
    """Reads the level, and publishes what came of it."""
    try:
        sample = level.read()
    except takt_port.PortError as error:
        nothing_yet = error.code == takt_port.Code.NO_ACTION
        plant.tell(None, None, "the PLC has published nothing yet" if nothing_yet else str(error))
        return
    metres = struct.unpack("<d", sample.bytes)[0] if len(sample.bytes) == 8 else math.nan
    if not math.isfinite(metres):
        plant.tell(None, sample.age, "the PLC publishes what is no level")
    else:
        plant.tell(metres, sample.age, None if sample.valid else "too old")


def own_ports(plant, level, setpoint):
    """Looks at the ports for ever. No other thread uses them, and no browser is waited for."""
    while True:
        look(plant, level)
        metres = plant.held()
        # What is not renewed grows old in the channel, and the PLC then goes back to its own.
        if metres is not None and setpoint is not None:
            setpoint.write(struct.pack("<d", metres))
        time.sleep(PERIOD_S)


class Request(io.RawIOBase):
    """What a browser sends: only so long, and only so much, however it is divided."""

    def __init__(self, connection):
        self._connection, self._end, self._left = connection, time.monotonic() + REQUEST_S, REQUEST_BYTES

    def readable(self):
        return True

    def readinto(self, buffer):
        time_left = self._end - time.monotonic()
        if time_left <= 0:
            raise socket.timeout("the request takes too long")
        self._connection.settimeout(time_left)
        count = self._connection.recv_into(memoryview(buffer)[: self._left])
        self._left -= count
        return count


class Browser(http.server.BaseHTTPRequestHandler):
    """One connection, with one request."""

    def setup(self):
        super().setup()
        self.rfile = io.BufferedReader(Request(self.connection))

    def do_GET(self):
        if self.path == "/":
            self.answer(200, "text/html; charset=utf-8", self.server.page)
        elif self.path == "/live":
            self.stream()
        else:
            self.send_error(404)

    def do_POST(self):
        try:
            self.check_sender()
            told = self.change()
            self.answer(200, "application/json", json.dumps(told).encode())
        except Refused as refused:
            self.answer(refused.args[0], "text/plain; charset=utf-8", refused.args[1].encode())

    def change(self):
        if not self.server.operate:
            raise Refused(403, "this page only shows; start it with --operate to set the level")
        length = self.headers.get("Content-Length", "")
        if not length.isascii() or not length.isdigit() or not 0 < int(length[:9]) <= 100:
            raise Refused(400, "the body has from 1 to 100 bytes")
        try:
            body = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            raise Refused(400, "the body is no JSON") from None
        if self.path == "/hold":
            return {"holder": self.server.plant.hold(body)}
        if self.path in ("/renew", "/release"):
            self.server.plant.renew(body, release=self.path == "/release")
            return {}
        raise Refused(404, "there is /hold, /renew and /release")

    def check_sender(self):
        """A page of somebody else's, open in an operator's browser, may not operate the plant through it."""
        host = self.headers.get("Host", "")
        if self.headers.get("Origin", f"http://{host}") != f"http://{host}":
            raise Refused(403, "the order comes from another page")
        # A name could lead anywhere, and to here a minute later.
        try:
            name = urlsplit(f"//{host}").hostname or ""
            if name != "localhost":
                ipaddress.ip_address(name)
        except ValueError:
            raise Refused(403, "open the page by its address in numbers") from None

    def stream(self):
        self.begin(200, "text/event-stream")
        looks = None
        while True:
            looks, shown = self.server.plant.wait(looks, STILL_S)
            self.wfile.write(b"data: %s\n\n" % json.dumps(shown).encode())

    def answer(self, status, kind, body):
        self.begin(status, kind)
        self.wfile.write(body)

    def begin(self, status, kind):
        self.connection.settimeout(UNREAD_S)
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        # The page needs nothing from elsewhere, and no other page may have it in a frame and an operator click there.
        self.send_header("Content-Security-Policy", "default-src 'self' 'unsafe-inline'; frame-ancestors 'none'")
        self.end_headers()

    def log_message(self, *_):
        """What strangers ask for is not worth a line of the journal each."""


class Server(socketserver.ThreadingTCPServer):
    """So many browsers at once and no more."""

    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = BROWSERS

    def __init__(self, address, plant, operate):
        super().__init__(address, Browser)
        self.plant, self.operate = plant, operate
        self.page = PAGE.read_bytes().replace(b"LOWEST", b"%g" % LOWEST).replace(b"HIGHEST", b"%g" % HIGHEST)
        self._places = threading.BoundedSemaphore(BROWSERS)
        # Connections have it from this one. Old values must not wait for a browser that does not read.
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, UNREAD_BYTES)

    def process_request(self, request, client_address):
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request, client_address):
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request, client_address):
        """A connection that ends in the middle ends nothing else."""


def main():
    parser = argparse.ArgumentParser(description="Shows the PLC's level on a page.")
    parser.add_argument("--address", default="127.0.0.1", help="where to listen (127.0.0.1: only this Linux)")
    parser.add_argument("--http-port", type=int, default=8080)
    parser.add_argument("--operate", action="store_true", help="each user of the page may set the level")
    options = parser.parse_args()
    plant = Plant()
    server = Server((options.address, options.http_port), plant, options.operate)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    # If this thread ends, so does the program, and whatever started it starts it again.
    with takt_port.Ports() as ports, ports.input("level") as level:
        if options.operate:
            with ports.output("setpoint") as setpoint:
                own_ports(plant, level, setpoint)
        own_ports(plant, level, None)


if __name__ == "__main__":
    main()
