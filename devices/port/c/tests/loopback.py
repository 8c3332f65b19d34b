"""Uses the Python package on the folder of a partition whose channels end in itself."""

import array
import faulthandler
import os
import signal
import struct
import sys
import threading
import time
import unittest

import takt_port
from takt_port import Code, PortError, Ports

FOLDER = sys.argv.pop()


class Loopback(unittest.TestCase):
    def assert_fails(self, code, call, *arguments, **named):
        with self.assertRaises(PortError) as caught:
            call(*arguments, **named)
        self.assertEqual(caught.exception.code, code)
        self.assertTrue(str(caught.exception))

    def test_ports_are_described(self):
        with Ports(FOLDER) as ports:
            described = {port.name: port for port in ports}
        self.assertEqual(list(described), ["out", "in", "send", "receive", "log", "trail"])
        self.assertEqual(described["in"], ("in", False, True, 512, 1, True, 1.0))
        self.assertEqual(described["send"], ("send", True, False, 512, 4, True, 0.0))

    def test_a_sample_arrives_and_a_newer_one_is_waited_for(self):
        with Ports(FOLDER) as ports, ports.output("out", anew=True) as out, ports.input("in", anew=True) as level:
            self.assert_fails(Code.NO_ACTION, level.read)
            out.write(struct.pack("<d", 1.25))
            sample = level.read()
            self.assertEqual(struct.unpack("<d", sample.bytes), (1.25,))
            self.assertGreaterEqual(sample.age, 0)
            self.assert_fails(Code.TIMED_OUT, level.read, newer_than=sample.stamp, timeout=0.001)
            out.write(b"next")
            self.assertEqual(level.read(newer_than=sample.stamp, timeout=None).bytes, b"next")
            self.assert_fails(Code.INVALID_PARAM, out.write, b"")
            self.assert_fails(Code.INVALID_CONFIG, out.write, bytes(513))

    def test_all_bytes_of_a_message_go_whatever_its_length_counts(self):
        class Longer(bytes):
            def __len__(self):
                return 64

        values = array.array("d", [1.25, 2.5])
        with Ports(FOLDER) as ports, ports.output("out") as out, ports.input("in") as level:
            with ports.sender("send") as sender, ports.receiver("receive", anew=True) as receiver:
                for message in values, memoryview(values), Longer(values.tobytes()):
                    out.write(message)
                    self.assertEqual(level.read().bytes, values.tobytes())
                    sender.send(message)
                    self.assertEqual(receiver.receive().bytes, values.tobytes())
                for nothing in 3, "text", None:
                    self.assertRaises(TypeError, out.write, nothing)
                    self.assertRaises(TypeError, sender.send, nothing)

    def test_a_queue_keeps_the_order_and_is_full_at_its_depth(self):
        with Ports(FOLDER) as ports, ports.sender("send") as sender, ports.receiver("receive", anew=True) as receiver:
            for n in range(4):
                sender.send(bytes([n]))
            self.assert_fails(Code.NOT_AVAILABLE, sender.send, b"x")
            self.assertEqual([receiver.receive().bytes for _ in range(4)], [b"\0", b"\1", b"\2", b"\3"])
            self.assert_fails(Code.NOT_AVAILABLE, receiver.receive)

    def test_an_overwritten_message_is_told(self):
        with Ports(FOLDER) as ports, ports.sender("log") as log, ports.receiver("trail", anew=True) as trail:
            for n in range(6):
                log.send(bytes([n]))
            first = trail.receive()
            self.assertEqual((first.bytes, first.overflowed), (b"\2", True))
            self.assertFalse(trail.receive().overflowed)

    def test_a_signal_ends_a_wait_that_has_no_end(self):
        class Stop(Exception):
            pass

        def stop(*_):
            raise Stop

        faulthandler.dump_traceback_later(60, exit=True)
        self.addCleanup(faulthandler.cancel_dump_traceback_later)
        self.addCleanup(signal.signal, signal.SIGALRM, signal.signal(signal.SIGALRM, stop))
        with Ports(FOLDER) as ports, ports.receiver("receive", anew=True) as receiver:
            with ports.input("in", anew=True) as level:
                for call in receiver.receive, level.read:
                    signal.setitimer(signal.ITIMER_REAL, 0.01)
                    self.assertRaises(Stop, call, timeout=None)

    def test_a_wait_is_as_long_as_it_says(self):
        with Ports(FOLDER) as ports, ports.receiver("receive", anew=True) as receiver:
            begun = time.monotonic()
            self.assert_fails(Code.TIMED_OUT, receiver.receive, timeout=0.5)
            self.assertGreaterEqual(time.monotonic() - begun, 0.5)
            self.assert_fails(Code.NOT_AVAILABLE, receiver.receive, timeout=-1)

    def test_a_close_in_another_thread_ends_a_wait(self):
        faulthandler.dump_traceback_later(60, exit=True)
        self.addCleanup(faulthandler.cancel_dump_traceback_later)
        with Ports(FOLDER) as ports, ports.receiver("receive", anew=True) as receiver:
            waiting = lambda: self.assert_fails(Code.BAD_ARGUMENT, receiver.receive, timeout=None)
            codes = []
            thread = threading.Thread(target=lambda: (waiting(), codes.append("told")))
            thread.start()
            time.sleep(0.05)
            receiver.close()
            thread.join()
            self.assertEqual(codes, ["told"])
            ports.receiver("receive").close()

    def handle_alarm(self, handler):
        faulthandler.dump_traceback_later(60, exit=True)
        self.addCleanup(faulthandler.cancel_dump_traceback_later)
        self.addCleanup(signal.signal, signal.SIGALRM, signal.signal(signal.SIGALRM, handler))

    def test_a_close_in_a_handler_ends_the_wait_that_it_interrupts(self):
        with Ports(FOLDER) as ports, ports.receiver("receive", anew=True) as receiver:
            self.handle_alarm(lambda *_: receiver.close())
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            self.assert_fails(Code.BAD_ARGUMENT, receiver.receive, timeout=None)
            ports.receiver("receive").close()

    def test_a_close_in_a_handler_leaves_the_handle_to_the_call_that_it_interrupts(self):
        def write(handle):
            signal.raise_signal(signal.SIGALRM)
            self.assert_fails(Code.NO_ACTION, ports.output, "out")
            return takt_port._library.takt_port_write(handle, b"whole", 5)

        with Ports(FOLDER) as ports, ports.output("out") as out, ports.input("in") as level:
            self.handle_alarm(lambda *_: out.close())
            out._call(write)
            self.assertEqual(level.read().bytes, b"whole")
            self.assert_fails(Code.BAD_ARGUMENT, out.write, b"x")
            ports.output("out").close()

    def test_a_call_in_a_handler_is_refused_if_it_interrupts_one(self):
        with Ports(FOLDER) as ports, ports.receiver("receive", anew=True) as receiver:
            told = []
            self.handle_alarm(lambda *_: told.append(self.assert_fails(Code.BAD_ARGUMENT, receiver.receive)))
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            self.assert_fails(Code.TIMED_OUT, receiver.receive, timeout=0.3)
            self.assertEqual(len(told), 1)
            self.assert_fails(Code.NOT_AVAILABLE, receiver.receive)

    def test_a_process_that_is_forked_during_a_call_closes_the_port_at_once(self):
        with Ports(FOLDER) as ports, ports.receiver("receive", anew=True) as receiver:
            thread = threading.Thread(target=self.assert_fails, args=(Code.BAD_ARGUMENT, receiver.receive, None))
            thread.start()
            time.sleep(0.05)
            closed, tell = os.pipe()
            child = os.fork()
            if child == 0:
                try:
                    signal.alarm(20)
                    self.assert_fails(Code.BAD_ARGUMENT, receiver.receive)
                    receiver.close()
                    self.assert_fails(Code.BAD_ARGUMENT, receiver.receive)
                    os.write(tell, b"closed")
                    signal.pause()
                finally:
                    os._exit(1)
            os.close(tell)
            told = os.read(closed, 6)
            os.close(closed)
            receiver.close()
            thread.join()
            try:
                self.assertEqual(told, b"closed")
                ports.receiver("receive").close()
            finally:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)

    def test_a_handler_that_forks_and_closes_leaves_the_handle_to_the_call_in_the_child(self):
        child = []

        def fork(*_):
            child.append(os.fork())
            if child[0] == 0:
                out.close()

        def write(handle):
            signal.raise_signal(signal.SIGALRM)
            return takt_port._library.takt_port_write(handle, b"parent", 6)

        with Ports(FOLDER) as ports, ports.output("out") as out, ports.input("in") as level:
            self.handle_alarm(fork)
            try:
                out._call(write)
            except PortError as error:
                os._exit(0 if error.code == Code.BAD_ARGUMENT and "_handle" not in vars(out) else 1)
            finally:
                if child == [0]:
                    os._exit(1)
            self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child[0], 0)[1]), 0)
            self.assertEqual(level.read().bytes, b"parent")

    def test_a_process_that_is_forked_has_no_port(self):
        with Ports(FOLDER) as ports, ports.output("out") as out, ports.input("in") as level:
            with ports.sender("send") as sender, ports.receiver("receive", anew=True) as receiver:
                out.write(b"parent")
                child = os.fork()
                if child == 0:
                    try:
                        for call in (lambda: out.write(b"x")), level.read, (lambda: sender.send(b"x")), receiver.receive:
                            self.assert_fails(Code.BAD_ARGUMENT, call)
                        out.close()
                        self.assert_fails(Code.NO_ACTION, ports.output, "out")
                        os._exit(0)
                    finally:
                        os._exit(1)
                self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 0)
                out.write(b"again")
                self.assertEqual(level.read().bytes, b"again")
                self.assert_fails(Code.NOT_AVAILABLE, receiver.receive)

    def test_a_port_that_is_not_there_in_use_or_of_another_kind_is_refused(self):
        with Ports(FOLDER) as ports, ports.output("out"):
            self.assert_fails(Code.INVALID_CONFIG, ports.output, "other")
            self.assert_fails(Code.INVALID_MODE, ports.input, "out")
            self.assert_fails(Code.INVALID_MODE, ports.sender, "out")
            self.assert_fails(Code.NO_ACTION, ports.output, "out")

    def test_a_closed_port_fails_and_does_not_crash(self):
        with Ports(FOLDER) as ports:
            out = ports.output("out")
            out.close()
            out.close()
            self.assert_fails(Code.BAD_ARGUMENT, out.write, b"x")
        self.assertEqual(list(ports), [])
        self.assert_fails(Code.SYSTEM, Ports, "/nowhere")


if __name__ == "__main__":
    unittest.main()
