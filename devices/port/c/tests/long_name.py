"""Uses a port whose name is as long as a name can be."""

import sys

import takt_port

NAME = 32 * "a"
with takt_port.Ports(sys.argv[1]) as ports:
    described = {port.name: port for port in ports}
    assert described[NAME] == (NAME, True, True, 512, 1, True, 1.0), described
    with ports.output(NAME) as out, ports.input("in") as level:
        out.write(b"level")
        assert level.read().bytes == b"level"
