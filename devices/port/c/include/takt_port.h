/* The ports of a Linux partition of Takt, for programs in C.
 *
 * A partition finds its ports by takt_ports_discover(), takes one by its name in the partition file, and then writes and
 * reads messages. Messages are bytes; the kernel takes no part in moving them. A port has one owner at a time.
 *
 * Every function but the closing ones returns a takt_port_code. With any other value than TAKT_PORT_NO_ERROR, which is 0,
 * nothing was sent, and there is no message in the buffer. Something may have gone on, however: takt_port_receive() skips a
 * message of which the other end says what cannot be, and returns TAKT_PORT_NOT_AVAILABLE, as it does for an empty queue. The
 * next call goes on behind it. The text tells the two apart. takt_port_last_error() gives the text of this thread's last failure.
 *
 * A handle belongs to one thread at a time, and no other may close it meanwhile. After a fork a port belongs to the parent:
 * the child can only close it, and takes its own. Until it does, or ends, the port is in use even if the parent has
 * closed it. Link with libtakt_port_c.a -lpthread -ldl -lm -lgcc_s.
 */
#ifndef TAKT_PORT_H
#define TAKT_PORT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* 0 to 6 are return codes of ARINC 653 part 1. */
typedef enum takt_port_code {
    TAKT_PORT_NO_ERROR = 0,
    TAKT_PORT_NO_ACTION = 1,      /* nothing was written yet, or nothing newer; or the port is in use */
    TAKT_PORT_NOT_AVAILABLE = 2,  /* the queue is empty or full; or the other end cannot be believed, and a message of
                                     its queue was skipped */
    TAKT_PORT_INVALID_PARAM = 3,  /* the message is empty, or the buffer is shorter than the longest message */
    TAKT_PORT_INVALID_CONFIG = 4, /* no such port, or the message is too long */
    TAKT_PORT_INVALID_MODE = 5,   /* the call does not fit the port's kind or direction */
    TAKT_PORT_TIMED_OUT = 6,
    TAKT_PORT_BAD_ARGUMENT = -1,  /* a null pointer, a text that is not UTF-8, or a port of the process before a fork */
    TAKT_PORT_SYSTEM = -2         /* no ports on this machine, or a file that cannot be used */
} takt_port_code;

typedef struct takt_ports takt_ports;
typedef struct takt_port takt_port;

#define TAKT_PORT_NAME_BYTES 33
#define TAKT_PORT_SOURCE 1
#define TAKT_PORT_DESTINATION 2
#define TAKT_PORT_SAMPLING 1
#define TAKT_PORT_QUEUING 2
/* A time-out: as long as it takes. 0 means not at all; other times are in nanoseconds. */
#define TAKT_PORT_FOREVER (-1)

typedef struct takt_port_description {
    char name[TAKT_PORT_NAME_BYTES];
    uint32_t direction;  /* TAKT_PORT_SOURCE or TAKT_PORT_DESTINATION, seen from this partition */
    uint32_t kind;       /* TAKT_PORT_SAMPLING or TAKT_PORT_QUEUING */
    size_t maximum;      /* longest message in bytes */
    uint32_t depth;      /* messages that can wait; 1 for a sampling port */
    uint32_t doorbell;   /* 1 if the channel has a doorbell */
    uint64_t refresh_ns; /* age up to which a message is valid; 0 for a queuing port */
} takt_port_description;

typedef struct takt_port_message {
    size_t length;
    uint64_t stamp;     /* when it was written, by the time-stamp counter */
    uint64_t age_ns;    /* nanoseconds since then; 0 for a queuing port */
    int32_t valid;      /* 1 if the age is within the refresh period; 1 for a queuing port */
    int32_t overflowed; /* 1 if messages before this one were overwritten */
} takt_port_message;

/* Finds the ports on the PCI bus. Needs root. */
takt_port_code takt_ports_discover(takt_ports **ports);
/* The ports of a function by its folder in sysfs. */
takt_port_code takt_ports_open(const char *folder, takt_ports **ports);
/* Ports that were opened go on. Null is allowed. */
void takt_ports_close(takt_ports *ports);
size_t takt_ports_count(const takt_ports *ports);
takt_port_code takt_ports_describe(const takt_ports *ports, size_t index, takt_port_description *description);

/* Takes a port. With anew 0 it goes on with what the owner before has left; otherwise the channel is emptied. */
takt_port_code takt_port_open(const takt_ports *ports, const char *name, int32_t anew, takt_port **port);
void takt_port_close(takt_port *port);

/* Sampling ports. Reading with known not null waits for a message with another stamp than *known. */
takt_port_code takt_port_write(takt_port *port, const void *bytes, size_t length);
takt_port_code takt_port_read(takt_port *port, void *buffer, size_t capacity, const uint64_t *known,
                              int64_t timeout_ns, takt_port_message *message);

/* Queuing ports. Sending waits for room, receiving for a message. A message before which others were overwritten is
 * TAKT_PORT_NO_ERROR, with overflowed in the message, where ARINC 653 has INVALID_CONFIG. */
takt_port_code takt_port_send(takt_port *port, const void *bytes, size_t length, int64_t timeout_ns);
takt_port_code takt_port_receive(takt_port *port, void *buffer, size_t capacity, int64_t timeout_ns,
                                 takt_port_message *message);

/* Good until this thread's next call; empty before the first failure. */
const char *takt_port_last_error(void);

#ifdef __cplusplus
}
#endif
#endif
