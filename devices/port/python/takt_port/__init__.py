"""The ports of a Linux partition of Takt.

    import struct, takt_port

    with takt_port.Ports() as ports:
        level = ports.input("level")
        sample = level.read()
        print(struct.unpack("<d", sample.bytes[:8])[0], sample.age, sample.valid)

`Ports` finds the ports. `output`, `input`, `sender` and `receiver` take one by its name in the partition file; a port has
one owner at a time. Messages are bytes: what is written or sent is an object that has them in memory, such as `bytes`, a
`bytearray` or an `array`, and all of its bytes go. Times are in seconds; a `timeout` of None waits as long as it takes. A
`PortError` has the return code in `code` (a `Code`) and says what was wrong.

A port belongs to one thread at a time, but another one may close it, and so may a signal's handler. A handler that
interrupts a call of a port cannot make another one of that port: it is BAD_ARGUMENT. A process that was forked cannot use
the ports of the one that it comes from; it may close them, and takes its own.

The package needs the shared library `libtakt_port.so`: beside this file, where the environment variable
TAKT_PORT_LIBRARY says, or where the system looks for libraries.
"""

import collections
import ctypes
import enum
import os
import pathlib
import threading
import time

__all__ = ["Code", "Description", "Input", "Output", "PortError", "Ports", "Receiver", "Sample", "Received", "Sender"]


class Code(enum.IntEnum):
    """Why a call brought nothing. 1 to 6 are return codes of ARINC 653."""

    NO_ACTION = 1
    NOT_AVAILABLE = 2
    INVALID_PARAM = 3
    INVALID_CONFIG = 4
    INVALID_MODE = 5
    TIMED_OUT = 6
    BAD_ARGUMENT = -1
    SYSTEM = -2


class PortError(Exception):
    """A call that failed."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = Code(code)


Description = collections.namedtuple("Description", "name source sampling maximum depth doorbell refresh")
Sample = collections.namedtuple("Sample", "bytes stamp age valid")
Received = collections.namedtuple("Received", "bytes stamp overflowed")


class _Description(ctypes.Structure):
    _fields_ = [
        ("name", ctypes.c_char * 33),
        ("direction", ctypes.c_uint32),
        ("kind", ctypes.c_uint32),
        ("maximum", ctypes.c_size_t),
        ("depth", ctypes.c_uint32),
        ("doorbell", ctypes.c_uint32),
        ("refresh_ns", ctypes.c_uint64),
    ]


class _Message(ctypes.Structure):
    _fields_ = [
        ("length", ctypes.c_size_t),
        ("stamp", ctypes.c_uint64),
        ("age_ns", ctypes.c_uint64),
        ("valid", ctypes.c_int32),
        ("overflowed", ctypes.c_int32),
    ]


def _load():
    beside = pathlib.Path(__file__).with_name("libtakt_port.so")
    name = os.environ.get("TAKT_PORT_LIBRARY") or (str(beside) if beside.exists() else "libtakt_port.so")
    library = ctypes.CDLL(name)
    handle, out = ctypes.c_void_p, ctypes.POINTER(ctypes.c_void_p)
    size, timeout, message = ctypes.c_size_t, ctypes.c_int64, ctypes.POINTER(_Message)
    known = ctypes.POINTER(ctypes.c_uint64)
    signatures = {
        "takt_ports_discover": [out],
        "takt_ports_open": [ctypes.c_char_p, out],
        "takt_ports_describe": [handle, size, ctypes.POINTER(_Description)],
        "takt_port_open": [handle, ctypes.c_char_p, ctypes.c_int32, out],
        "takt_port_write": [handle, ctypes.c_char_p, size],
        "takt_port_send": [handle, ctypes.c_char_p, size, timeout],
        "takt_port_read": [handle, ctypes.c_char_p, size, known, timeout, message],
        "takt_port_receive": [handle, ctypes.c_char_p, size, timeout, message],
    }
    for function, arguments in signatures.items():
        getattr(library, function).argtypes = arguments
        getattr(library, function).restype = ctypes.c_int
    for function in ("takt_ports_close", "takt_port_close"):
        getattr(library, function).argtypes = [handle]
        getattr(library, function).restype = None
    library.takt_ports_count.argtypes = [handle]
    library.takt_ports_count.restype = size
    library.takt_port_last_error.restype = ctypes.c_char_p
    return library


_library = _load()


def _check(code):
    if code != 0:
        raise PortError(code, _library.takt_port_last_error().decode(errors="replace"))


# The longest stay in the library in one piece. Python acts on a signal, such as that of Ctrl-C, only outside of it.
_SLICE_S = 0.2


def _bytes(message):
    # The length of an object need not be that of its bytes, and bytes(3) would be three zeros.
    return memoryview(message).tobytes()


class Ports:
    """The ports of this partition; `folder` is that of the PCI function in sysfs, found if it is not given."""

    def __init__(self, folder=None):
        self._handle = ctypes.c_void_p()
        if folder is None:
            _check(_library.takt_ports_discover(ctypes.byref(self._handle)))
        else:
            _check(_library.takt_ports_open(os.fsencode(folder), ctypes.byref(self._handle)))

    def close(self):
        """Lets go of the list of ports. Ports that were taken go on."""
        handle, self._handle = self._handle, ctypes.c_void_p()
        _library.takt_ports_close(handle)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def __iter__(self):
        """Describes each port."""
        for index in range(_library.takt_ports_count(self._handle)):
            found = _Description()
            _check(_library.takt_ports_describe(self._handle, index, ctypes.byref(found)))
            yield Description(
                found.name.decode(),
                found.direction == 1,
                found.kind == 1,
                found.maximum,
                found.depth,
                found.doorbell == 1,
                found.refresh_ns / 1e9,
            )

    def output(self, name, anew=False):
        """Takes a sampling port that this partition writes."""
        return Output(self, name, anew)

    def input(self, name, anew=False):
        """Takes a sampling port that this partition reads."""
        return Input(self, name, anew)

    def sender(self, name, anew=False):
        """Takes a queuing port that this partition sends to."""
        return Sender(self, name, anew)

    def receiver(self, name, anew=False):
        """Takes a queuing port that this partition receives from."""
        return Receiver(self, name, anew)


class _Port:
    # What the partition file has to say of the port: is it a source, is it a sampling port?
    _source = None
    _sampling = None

    def __init__(self, ports, name, anew):
        self._handle = ctypes.c_void_p()
        # A signal's handler may close the port while its own thread has the lock.
        self._lock, self._closed = threading.RLock(), False
        # The thread that is in a call. In a forked process it may be one that is not there, and then nothing frees the lock.
        self._caller, self._process = None, os.getpid()
        # For a port that the library knows and does not describe: nothing can be read into it, which is INVALID_PARAM.
        self._buffer = ctypes.create_string_buffer(0)
        for port in ports:
            if port.name == name and (port.source, port.sampling) != (self._source, self._sampling):
                kind = "sampling" if port.sampling else "queuing"
                direction = "source" if port.source else "destination"
                raise PortError(Code.INVALID_MODE, f"port {name} is a {kind} {direction}")
            if port.name == name:
                self._buffer = ctypes.create_string_buffer(port.maximum)
        _check(_library.takt_port_open(ports._handle, name.encode(), int(anew), ctypes.byref(self._handle)))

    def close(self):
        """Lets go of the port, so that another process can take it. A call that waits in another thread ends within 0.2 s.

        In a signal's handler that interrupts a call of the port, the port is let go of when that call ends.
        """
        self._closed = True
        if self._process != os.getpid():
            self._free()
        else:
            with self._lock:
                self._free()

    def _free(self):
        # The call that a handler has interrupted may be about to use the handle; it frees the handle itself.
        if self._caller is not threading.current_thread():
            # In one step: a handler that comes in between would free the handle too.
            _library.takt_port_close(self.__dict__.pop("_handle", None))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _call(self, call, taken=lambda: None):
        if self._process != os.getpid():
            raise PortError(Code.BAD_ARGUMENT, "the port belongs to the process from which this one was forked")
        # Under the lock, so that no other thread closes the port or overwrites the buffer. After a close the handle is null.
        with self._lock:
            if self._caller is not None:
                raise PortError(Code.BAD_ARGUMENT, "a signal's handler has interrupted a call of this port")
            try:
                self._caller = threading.current_thread()
                _check(call(None if self._closed else self._handle))
                return taken()
            finally:
                self._caller = None
                if self._closed:
                    self._free()

    def _wait(self, timeout, call, taken=lambda: None):
        """Calls with times to wait, in nanoseconds, until so many seconds are over."""
        if timeout is not None and timeout <= 0:
            return self._call(lambda handle: call(handle, 0), taken)
        end = None if timeout is None else time.monotonic() + timeout
        left = timeout
        while True:
            piece = _SLICE_S if left is None else min(left, _SLICE_S)
            try:
                return self._call(lambda handle: call(handle, max(1, int(piece * 1e9))), taken)
            except PortError as error:
                left = None if end is None else end - time.monotonic()
                if error.code != Code.TIMED_OUT or left is not None and left <= 0:
                    raise

    def _taken(self, message):
        return ctypes.string_at(self._buffer, message.length)


class Output(_Port):
    """A sampling port that this partition writes."""

    _source, _sampling = True, True

    def write(self, message):
        """Replaces the message. Never waits."""
        data = _bytes(message)
        self._call(lambda handle: _library.takt_port_write(handle, data, len(data)))


class Input(_Port):
    """A sampling port that this partition reads."""

    _source, _sampling = False, True

    def read(self, newer_than=None, timeout=0):
        """The newest message as a `Sample`. With `newer_than`, the stamp of a sample, it waits for another one."""
        message = _Message()
        known = None if newer_than is None else ctypes.byref(ctypes.c_uint64(newer_than))
        size, into = len(self._buffer), ctypes.byref(message)
        return self._wait(
            timeout,
            lambda handle, wait: _library.takt_port_read(handle, self._buffer, size, known, wait, into),
            lambda: Sample(self._taken(message), message.stamp, message.age_ns / 1e9, message.valid == 1),
        )


class Sender(_Port):
    """A queuing port that this partition sends to."""

    _source, _sampling = True, False

    def send(self, message, timeout=0):
        """Sends a message, and waits so long for room."""
        data = _bytes(message)
        self._wait(timeout, lambda handle, wait: _library.takt_port_send(handle, data, len(data), wait))


class Receiver(_Port):
    """A queuing port that this partition receives from."""

    _source, _sampling = False, False

    def receive(self, timeout=0):
        """Takes the oldest message as a `Received`, and waits so long for one.

        NOT_AVAILABLE is an empty queue, or a message that cannot be believed and was skipped: the text tells which.

        If a signal's handler raises, as that of Ctrl-C does, a message that has just been taken is lost.
        """
        message = _Message()
        size, into = len(self._buffer), ctypes.byref(message)
        return self._wait(
            timeout,
            lambda handle, wait: _library.takt_port_receive(handle, self._buffer, size, wait, into),
            lambda: Received(self._taken(message), message.stamp, message.overflowed == 1),
        )
