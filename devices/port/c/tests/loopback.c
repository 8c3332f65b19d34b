/* Uses each function once as a program would, then each wrongly. The folder is that of a partition whose channels end
 * in itself. Exit status 0 if all went as it should; otherwise the line of the first thing that did not is printed. */
#include "takt_port.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXPECT(condition)                                                                                              \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            fprintf(stderr, "line %d: %s (last error: %s)\n", __LINE__, #condition, takt_port_last_error());           \
            exit(1);                                                                                                   \
        }                                                                                                              \
    } while (0)

static takt_port *opened(takt_ports *ports, const char *name) {
    takt_port *port = NULL;
    EXPECT(takt_port_open(ports, name, 0, &port) == TAKT_PORT_NO_ERROR);
    return port;
}

int main(int count, char **arguments) {
    takt_ports *ports = NULL;
    takt_port_description description;
    takt_port_message message;
    char buffer[512];

    EXPECT(count == 2);
    EXPECT(takt_ports_open(arguments[1], &ports) == TAKT_PORT_NO_ERROR);
    EXPECT(takt_ports_count(ports) == 6);
    EXPECT(takt_ports_describe(ports, 1, &description) == TAKT_PORT_NO_ERROR);
    EXPECT(strcmp(description.name, "in") == 0 && description.direction == TAKT_PORT_DESTINATION);
    EXPECT(description.kind == TAKT_PORT_SAMPLING && description.maximum == 512 && description.depth == 1);
    EXPECT(description.doorbell == 1 && description.refresh_ns == 1000000000);

    takt_port *out = opened(ports, "out"), *in = opened(ports, "in");
    EXPECT(takt_port_read(in, buffer, sizeof buffer, NULL, 0, &message) == TAKT_PORT_NO_ACTION);
    EXPECT(takt_port_write(out, "level", 5) == TAKT_PORT_NO_ERROR);
    EXPECT(takt_port_read(in, buffer, sizeof buffer, NULL, 0, &message) == TAKT_PORT_NO_ERROR);
    EXPECT(message.length == 5 && memcmp(buffer, "level", 5) == 0 && message.stamp != 0);
    uint64_t known = message.stamp;
    EXPECT(takt_port_read(in, buffer, sizeof buffer, &known, 0, &message) == TAKT_PORT_NO_ACTION);
    EXPECT(takt_port_read(in, buffer, sizeof buffer, &known, 1000000, &message) == TAKT_PORT_TIMED_OUT);

    takt_port *send = opened(ports, "send"), *receive = opened(ports, "receive");
    for (int n = 0; n < 4; n++)
        EXPECT(takt_port_send(send, &n, sizeof n, 0) == TAKT_PORT_NO_ERROR);
    EXPECT(takt_port_send(send, "x", 1, 0) == TAKT_PORT_NOT_AVAILABLE);
    EXPECT(takt_port_send(send, "x", 1, 1000000) == TAKT_PORT_TIMED_OUT);
    /* Ports go on without the handle that they were opened with. */
    takt_ports_close(ports);
    for (int n = 0; n < 4; n++) {
        int got = -1;
        EXPECT(takt_port_receive(receive, buffer, sizeof buffer, TAKT_PORT_FOREVER, &message) == TAKT_PORT_NO_ERROR);
        EXPECT(message.length == sizeof got && !message.overflowed);
        memcpy(&got, buffer, sizeof got);
        EXPECT(got == n);
    }
    EXPECT(takt_port_receive(receive, buffer, sizeof buffer, 0, &message) == TAKT_PORT_NOT_AVAILABLE);

    /* What does not fit is refused, with a text. */
    EXPECT(takt_port_write(in, "x", 1) == TAKT_PORT_INVALID_MODE);
    EXPECT(strstr(takt_port_last_error(), "a sampling destination") != NULL);
    EXPECT(takt_port_send(out, "x", 1, 0) == TAKT_PORT_INVALID_MODE);
    EXPECT(takt_port_read(receive, buffer, sizeof buffer, NULL, 0, &message) == TAKT_PORT_INVALID_MODE);
    EXPECT(takt_port_receive(in, buffer, sizeof buffer, 0, &message) == TAKT_PORT_INVALID_MODE);
    EXPECT(takt_port_write(out, buffer, sizeof buffer + 1) == TAKT_PORT_INVALID_CONFIG);
    EXPECT(takt_port_write(out, buffer, 0) == TAKT_PORT_INVALID_PARAM);
    EXPECT(takt_port_read(in, buffer, 1, NULL, 0, &message) == TAKT_PORT_INVALID_PARAM);
    EXPECT(takt_port_write(NULL, "x", 1) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_port_write(out, NULL, 1) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_port_read(in, NULL, 0, NULL, 0, &message) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_port_receive(receive, buffer, sizeof buffer, 0, NULL) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_ports_describe(NULL, 0, &description) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_ports_count(NULL) == 0);

    ports = NULL;
    EXPECT(takt_ports_open("/nowhere", &ports) == TAKT_PORT_SYSTEM && ports == NULL);
    EXPECT(takt_ports_open(NULL, &ports) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_ports_open("\xff", &ports) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_ports_open(arguments[1], NULL) == TAKT_PORT_BAD_ARGUMENT);
    EXPECT(takt_ports_open(arguments[1], &ports) == TAKT_PORT_NO_ERROR);
    EXPECT(takt_ports_describe(ports, 6, &description) == TAKT_PORT_BAD_ARGUMENT);
    takt_port *port = NULL;
    EXPECT(takt_port_open(ports, "other", 0, &port) == TAKT_PORT_INVALID_CONFIG && port == NULL);
    EXPECT(takt_port_open(ports, "in", 0, &port) == TAKT_PORT_NO_ACTION && port == NULL);
    takt_port_close(in);
    EXPECT(takt_port_open(ports, "in", 1, &port) == TAKT_PORT_NO_ERROR && port != NULL);
    EXPECT(takt_port_read(port, buffer, sizeof buffer, NULL, 0, &message) == TAKT_PORT_NO_ACTION);

    takt_port_close(port);
    takt_port_close(out);
    takt_port_close(send);
    takt_port_close(receive);
    takt_port_close(NULL);
    takt_ports_close(ports);
    takt_ports_close(NULL);
    return 0;
}
