"""The server of the example level_page.py: with browsers that are wrong, slow or too many, on the folder of a partition
whose channels end in itself."""

import http.client
import json
import pathlib
import socket
import struct
import sys
import threading
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "python" / "examples"))
import level_page
from level_page import Plant, Refused, Server, look
from takt_port import Ports

FOLDER = sys.argv.pop()


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


class Held(unittest.TestCase):
    def setUp(self):
        self.clock = Clock()
        self.plant = Plant(self.clock)

    def assert_refused(self, status, call, *arguments, **named):
        with self.assertRaises(Refused) as caught:
            call(*arguments, **named)
        self.assertEqual(caught.exception.args[0], status)

    def test_a_setpoint_is_held_as_long_as_its_page_renews_it(self):
        holder = self.plant.hold(1.5)
        self.clock.now += level_page.HOLD_S - 0.1
        self.plant.renew(holder)
        self.clock.now += level_page.HOLD_S - 0.1
        self.assertEqual(self.plant.held(), 1.5)
        self.clock.now += 0.1
        self.assertIsNone(self.plant.held())
        self.assert_refused(409, self.plant.renew, holder)

    def test_the_last_operator_has_it_and_only_its_page_renews_and_releases(self):
        first, second = self.plant.hold(1.5), self.plant.hold(0.5)
        self.assert_refused(409, self.plant.renew, first)
        self.assert_refused(409, self.plant.renew, first, release=True)
        self.assertEqual(self.plant.held(), 0.5)
        self.plant.renew(second, release=True)
        self.assertIsNone(self.plant.held())
        self.assert_refused(409, self.plant.renew, None)

    def test_what_is_no_setpoint_is_refused_and_changes_nothing(self):
        self.plant.hold(1.0)
        for wrong in (float("nan"), float("inf"), -0.1, 2.1, 10**400, True, None, "1", [1.0], {}):
            self.assert_refused(400, self.plant.hold, wrong)
        self.assertEqual(self.plant.held(), 1.0)

    def test_a_level_is_good_only_if_it_was_valid_when_it_was_read_and_that_was_just_now(self):
        with Ports(FOLDER) as ports, ports.output("out", anew=True) as out, ports.input("in", anew=True) as level:
            told = lambda: self.plant.wait(None, 0)[1]
            self.assertEqual(told()["problem"], "the ports have not been read yet")
            look(self.plant, level)
            self.assertEqual(told()["problem"], "the PLC has published nothing yet")
            out.write(struct.pack("<d", 1.25))
            look(self.plant, level)
            self.assertEqual((told()["level"], told()["problem"]), (1.25, None))
            # The refresh period of this port.
            time.sleep(1.1)
            look(self.plant, level)
            self.assertEqual((told()["level"], told()["problem"]), (1.25, "too old"))
            self.assertGreater(told()["age"], 1.0)
            for wrong in (b"1.25", struct.pack("<d", float("nan"))):
                out.write(wrong)
                look(self.plant, level)
                self.assertEqual((told()["level"], told()["problem"]), (None, "the PLC publishes what is no level"))
            out.write(struct.pack("<d", 1.25))
            look(self.plant, level)
            self.clock.now += level_page.STILL_S + 0.1
            self.assertEqual(told()["problem"], "the ports are not read any more")
            self.assertGreater(told()["age"], level_page.STILL_S)


class Served(unittest.TestCase):
    def setUp(self):
        level_page.REQUEST_S = level_page.UNREAD_S = 1.0
        self.plant = Plant()
        self.plant.tell(1.0, 0.001, None)
        self.serve(operate=True)

    def serve(self, operate):
        self.server = Server(("127.0.0.1", 0), self.plant, operate)
        self.addCleanup(self.server.server_close)
        self.addCleanup(self.server.shutdown)
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def connect(self):
        connection = socket.create_connection(self.server.server_address, timeout=5)
        self.addCleanup(connection.close)
        return connection

    def ask(self, method, path, body=None, **headers):
        connection = http.client.HTTPConnection(*self.server.server_address, timeout=5)
        self.addCleanup(connection.close)
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()

    def test_a_page_holds_renews_and_releases(self):
        self.assertIn(b'max="2"', self.ask("GET", "/")[1])
        status, answer = self.ask("POST", "/hold", "1.5")
        holder = json.dumps(json.loads(answer)["holder"])
        self.assertEqual((status, self.plant.held()), (200, 1.5))
        self.assertEqual(self.ask("POST", "/renew", holder), (200, b"{}"))
        self.assertEqual(self.ask("POST", "/release", holder), (200, b"{}"))
        self.assertIsNone(self.plant.held())

    def test_what_is_wrong_is_refused(self):
        for body in ("", "NaN", "9", "x" * 101, "[" * 100, "\xff"):
            self.assertEqual(self.ask("POST", "/hold", body)[0], 400, body)
        for length in ("-1", "0", "9" * 500, "1e1", "\xb2"):
            self.assertEqual(self.ask("POST", "/hold", None, **{"Content-Length": length})[0], 400, length)
        self.assertEqual(self.ask("POST", "/hold", "1", Origin="http://elsewhere.example")[0], 403)
        self.assertEqual(self.ask("POST", "/hold", "1", Host="rebound.example")[0], 403)
        self.assertEqual(self.ask("POST", "/hold", "1", Host="[")[0], 403)
        self.assertEqual([self.ask("GET", path)[0] for path in ("/../etc/passwd", "/x")], [404, 404])
        self.assertEqual(self.ask("POST", "/x", "1")[0], 404)
        self.assertIsNone(self.plant.held())
        self.serve(operate=False)
        self.assertEqual(self.ask("POST", "/hold", "1")[0], 403)
        self.assertIsNone(self.plant.held())

    def test_a_request_that_is_too_slow_or_too_long_ends(self):
        slow, long = self.connect(), self.connect()
        long.sendall(b"GET / HTTP/1.0\r\n" + b"x: y\r\n" * 2000)
        begun = time.monotonic()
        slow.sendall(b"GET / HTTP/1.0\r\n")
        with self.assertRaises(OSError):
            while True:
                slow.sendall(b"a: b\r\n")
                time.sleep(0.1)
        self.assertLess(time.monotonic() - begun, 10)
        try:
            self.assertNotIn(b"200 OK", long.recv(100))
        except ConnectionError:
            pass

    def test_browsers_that_read_nothing_hold_up_nobody_and_are_given_up(self):
        deaf = [self.connect() for _ in range(level_page.BROWSERS - 1)]
        for connection in deaf:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            connection.sendall(b"GET /live HTTP/1.0\r\n\r\n")
        reader = self.connect()
        reader.sendall(b"GET /live HTTP/1.0\r\n\r\n")
        time.sleep(0.3)
        # All places are taken.
        further = self.connect()
        further.sendall(b"GET / HTTP/1.0\r\n\r\n")
        try:
            self.assertEqual(further.recv(100), b"")
        except ConnectionError:
            pass
        end = time.monotonic() + 20
        with reader.makefile("rb") as lines:
            # More than fits between the two ends.
            for n in range(20000):
                self.plant.tell(float(n), 0.001, None)
                if n % 500 == 0:
                    while b'"level": ' + str(float(n)).encode() not in lines.readline():
                        self.assertLess(time.monotonic(), end)
        reader.close()
        # Their places are free again once they have been given up.
        while True:
            try:
                if self.ask("GET", "/")[0] == 200:
                    break
            except (OSError, http.client.HTTPException):
                self.assertLess(time.monotonic(), end)
                time.sleep(0.1)


if __name__ == "__main__":
    unittest.main()
