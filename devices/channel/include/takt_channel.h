/*
 * The regions of a Takt port channel, for C (C11) and what can read C headers.
 *
 * Semantics, who writes what and the order of accesses: docs/ports.md. Every 64-bit field is
 * aligned; access it whole, with acquire loads and release stores. All values are little-endian.
 */
#ifndef TAKT_CHANNEL_H
#define TAKT_CHANNEL_H

#include <stddef.h>
#include <stdint.h>

#define TAKT_CHANNEL_MAGIC UINT32_C(0x48434b54) /* "TKCH" */
#define TAKT_CHANNEL_VERSION 1u
#define TAKT_CHANNEL_SPARE 3u         /* slots beyond the depth */
#define TAKT_CHANNEL_MESSAGE_MAX 65536u /* bytes */
#define TAKT_CHANNEL_DEPTH_MAX 1024u  /* messages */

enum takt_channel_kind {
    TAKT_CHANNEL_SAMPLING = 1,
    TAKT_CHANNEL_QUEUING = 2,
    TAKT_CHANNEL_ACKNOWLEDGEMENT = 3
};

/* In a sampling channel the field is 0. */
enum takt_channel_policy {
    TAKT_CHANNEL_REFUSE = 1,
    TAKT_CHANNEL_OVERWRITE = 2
};

enum takt_return_code {
    TAKT_NO_ERROR = 0,
    TAKT_NO_ACTION = 1,
    TAKT_NOT_AVAILABLE = 2,
    TAKT_INVALID_PARAM = 3,
    TAKT_INVALID_CONFIG = 4,
    TAKT_INVALID_MODE = 5,
    TAKT_TIMED_OUT = 6
};

/* Written by the VMM before the owner of the region starts; never changes. */
struct takt_channel_header {
    uint32_t magic;
    uint32_t version;
    uint32_t kind;
    uint32_t policy;
    uint32_t maximum; /* longest message, bytes */
    uint32_t depth;   /* messages; 1 in a sampling channel */
    uint32_t slots;   /* depth + TAKT_CHANNEL_SPARE */
    uint32_t reserved[9];
};

/* A region of messages. Slots follow at its end. Written by the source only. */
struct takt_channel_messages {
    struct takt_channel_header header;
    uint64_t epoch;   /* starts of the source */
    uint64_t first;   /* number of the first message of this life */
    uint64_t written; /* number of the message to be written next */
    uint64_t reserved[5];
};

/* The acknowledgement of a queuing channel. Written by the destination only. */
struct takt_channel_acknowledgement {
    struct takt_channel_header header;
    uint64_t epoch; /* starts of the destination */
    uint64_t read;  /* number of the message to be taken next */
    uint64_t reserved[6];
};

/* Message n lies in slot n % slots. */
struct takt_channel_slot {
    uint64_t sequence; /* 2n + 1 while message n is written, 2n + 2 after */
    uint64_t stamp;    /* TSC given by the source */
    uint64_t length;   /* bytes, 1 to maximum */
    uint64_t payload[]; /* filled up with zeros */
};

/* Distance of two slots in bytes: a multiple of 64. */
static inline size_t takt_channel_slot_bytes(uint32_t maximum)
{
    return (sizeof(struct takt_channel_slot) + (size_t)maximum + 63u) / 64u * 64u;
}

/* Length of a region of messages in bytes. */
static inline size_t takt_channel_region_bytes(uint32_t maximum, uint32_t depth)
{
    return sizeof(struct takt_channel_messages)
        + ((size_t)depth + TAKT_CHANNEL_SPARE) * takt_channel_slot_bytes(maximum);
}

_Static_assert(offsetof(struct takt_channel_header, magic) == 0, "layout");
_Static_assert(offsetof(struct takt_channel_header, version) == 4, "layout");
_Static_assert(offsetof(struct takt_channel_header, kind) == 8, "layout");
_Static_assert(offsetof(struct takt_channel_header, policy) == 12, "layout");
_Static_assert(offsetof(struct takt_channel_header, maximum) == 16, "layout");
_Static_assert(offsetof(struct takt_channel_header, depth) == 20, "layout");
_Static_assert(offsetof(struct takt_channel_header, slots) == 24, "layout");
_Static_assert(sizeof(struct takt_channel_header) == 64, "layout");
_Static_assert(offsetof(struct takt_channel_messages, epoch) == 64, "layout");
_Static_assert(offsetof(struct takt_channel_messages, first) == 72, "layout");
_Static_assert(offsetof(struct takt_channel_messages, written) == 80, "layout");
_Static_assert(sizeof(struct takt_channel_messages) == 128, "layout");
_Static_assert(offsetof(struct takt_channel_acknowledgement, epoch) == 64, "layout");
_Static_assert(offsetof(struct takt_channel_acknowledgement, read) == 72, "layout");
_Static_assert(sizeof(struct takt_channel_acknowledgement) == 128, "layout");
_Static_assert(offsetof(struct takt_channel_slot, sequence) == 0, "layout");
_Static_assert(offsetof(struct takt_channel_slot, stamp) == 8, "layout");
_Static_assert(offsetof(struct takt_channel_slot, length) == 16, "layout");
_Static_assert(offsetof(struct takt_channel_slot, payload) == 24, "layout");

#endif
