/* Prints what takt_channel.h says, for the test that compares it with the Rust side. */
#include "takt_channel.h"

#include <stdio.h>

#define OFFSET(type, field) printf(#field "=%zu\n", offsetof(struct type, field))
#define CHANNEL(name) printf(#name "=%lu\n", (unsigned long)TAKT_CHANNEL_##name)
#define CODE(name) printf(#name "=%d\n", TAKT_##name)

static void sizes(uint32_t maximum, uint32_t depth)
{
    printf("slot %u=%zu\n", maximum, takt_channel_slot_bytes(maximum));
    printf("region %u %u=%zu\n", maximum, depth, takt_channel_region_bytes(maximum, depth));
}

int main(void)
{
    OFFSET(takt_channel_header, magic);
    OFFSET(takt_channel_header, version);
    OFFSET(takt_channel_header, kind);
    OFFSET(takt_channel_header, policy);
    OFFSET(takt_channel_header, maximum);
    OFFSET(takt_channel_header, depth);
    OFFSET(takt_channel_header, slots);
    OFFSET(takt_channel_messages, epoch);
    OFFSET(takt_channel_messages, first);
    OFFSET(takt_channel_messages, written);
    OFFSET(takt_channel_acknowledgement, read);
    OFFSET(takt_channel_slot, sequence);
    OFFSET(takt_channel_slot, stamp);
    OFFSET(takt_channel_slot, length);
    OFFSET(takt_channel_slot, payload);
    printf("header_bytes=%zu\n", sizeof(struct takt_channel_messages));
    printf("acknowledgement_bytes=%zu\n", sizeof(struct takt_channel_acknowledgement));
    CHANNEL(MAGIC);
    CHANNEL(VERSION);
    CHANNEL(SPARE);
    CHANNEL(MESSAGE_MAX);
    CHANNEL(DEPTH_MAX);
    CHANNEL(SAMPLING);
    CHANNEL(QUEUING);
    CHANNEL(ACKNOWLEDGEMENT);
    CHANNEL(REFUSE);
    CHANNEL(OVERWRITE);
    CODE(NO_ERROR);
    CODE(NO_ACTION);
    CODE(NOT_AVAILABLE);
    CODE(INVALID_PARAM);
    CODE(INVALID_CONFIG);
    CODE(INVALID_MODE);
    CODE(TIMED_OUT);
    sizes(1, 1);
    sizes(40, 2);
    sizes(41, 3);
    sizes(TAKT_CHANNEL_MESSAGE_MAX, TAKT_CHANNEL_DEPTH_MAX);
    return 0;
}
