/* The C codec as a filter, so that it can be run under sanitizers and compared with the Python one.
 *
 * codec_filter decode: bytes in; a line "TYPE FIELD..." for each message, then "FRAMES OVERLONG COBS LENGTH CRC TYPE"
 * codec_filter encode: lines "TYPE FIELD..." in; a line with the frame in hexadecimal for each, empty if there is none
 * codec_filter constants: protocol version, schema hash, bytes of the longest frame
 * codec_filter crc SEED: bytes in, at most 255; their checksum
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "beamtouch_protocol.h"

#define MAX_FIELDS 64

static void print_reading(const beamtouch_reading *reading) {
    printf(" %u %" PRIu32 " %u", reading->sequence, reading->device_us, reading->oversampling);
    for (uint8_t channel = 0; channel < reading->channel_count; channel++) printf(" %u", reading->counts[channel]);
}

static void print_hello(const beamtouch_hello *hello) {
    printf(" %u %" PRIu32 " %" PRIu32, hello->protocol_version, hello->schema_hash, hello->boot_id);
    printf(" %u %u %u", hello->channel_count, hello->adc_bits, hello->max_rate_hz);
}

static void print_message(const beamtouch_message *message) {
    printf("%u", message->type);
    switch (message->type) {
    case BEAMTOUCH_PING: printf(" %u", message->as.ping.token); break;
    case BEAMTOUCH_IDENTIFY: printf(" %u", message->as.identify.seconds); break;
    case BEAMTOUCH_START: printf(" %u %u", message->as.start.rate_hz, message->as.start.oversampling); break;
    case BEAMTOUCH_HELLO: print_hello(&message->as.hello); break;
    case BEAMTOUCH_PONG: printf(" %u %" PRIu32, message->as.pong.token, message->as.pong.device_us); break;
    case BEAMTOUCH_READING: print_reading(&message->as.reading); break;
    }
    printf("\n");
}

static void decode(void) {
    beamtouch_decoder decoder = {0};
    beamtouch_message message;
    for (int byte = getchar(); byte != EOF; byte = getchar()) {
        if (beamtouch_decode(&decoder, (uint8_t)byte, &message)) print_message(&message);
    }
    printf("%" PRIu32, decoder.frames);
    for (int reason = 0; reason < BEAMTOUCH_REJECTIONS; reason++) printf(" %" PRIu32, decoder.rejected[reason]);
    printf("\n");
}

/* Split "TYPE FIELD..." into numbers; returns their count. */
static size_t split(char *line, uint32_t *numbers) {
    size_t count = 0;
    for (char *word = strtok(line, " \n"); word != NULL && count < MAX_FIELDS; word = strtok(NULL, " \n")) {
        numbers[count++] = (uint32_t)strtoul(word, NULL, 10);
    }
    return count;
}

static void fill_reading(beamtouch_reading *reading, const uint32_t *fields, size_t count) {
    reading->sequence = (uint16_t)fields[0];
    reading->device_us = fields[1];
    reading->oversampling = (uint8_t)fields[2];
    reading->channel_count = (uint8_t)(count - 3);
    for (size_t channel = 0; channel < count - 3 && channel < BEAMTOUCH_MAX_CHANNELS; channel++) {
        reading->counts[channel] = (uint16_t)fields[3 + channel];
    }
}

static void fill(beamtouch_message *message, const uint32_t *fields, size_t count) {
    switch (message->type) {
    case BEAMTOUCH_PING: message->as.ping.token = (uint16_t)fields[0]; break;
    case BEAMTOUCH_IDENTIFY: message->as.identify.seconds = (uint8_t)fields[0]; break;
    case BEAMTOUCH_START: message->as.start = (beamtouch_start){(uint16_t)fields[0], (uint8_t)fields[1]}; break;
    case BEAMTOUCH_HELLO:
        message->as.hello = (beamtouch_hello){(uint8_t)fields[0], fields[1],          fields[2],
                                              (uint8_t)fields[3], (uint8_t)fields[4], (uint16_t)fields[5]};
        break;
    case BEAMTOUCH_PONG: message->as.pong = (beamtouch_pong){(uint16_t)fields[0], fields[1]}; break;
    case BEAMTOUCH_READING: fill_reading(&message->as.reading, fields, count); break;
    }
}

static void encode(void) {
    char line[1024];
    while (fgets(line, sizeof line, stdin) != NULL) {
        uint32_t numbers[MAX_FIELDS] = {0};
        size_t count = split(line, numbers);
        beamtouch_message message = {.type = (uint8_t)numbers[0]};
        fill(&message, numbers + 1, count - 1);
        /* A new buffer of exactly the promised length for each frame, so that the sanitizer detects a byte too many. */
        size_t room = message.type == BEAMTOUCH_READING ? BEAMTOUCH_READING_FRAME_BYTES(count - 4)
                                                        : BEAMTOUCH_HELLO_FRAME_BYTES;
        uint8_t *frame = malloc(room);
        if (frame == NULL) exit(1);
        uint8_t length = beamtouch_encode(&message, frame);
        for (uint8_t place = 0; place < length; place++) printf("%02x", frame[place]);
        printf("\n");
        free(frame);
    }
}

static void crc(uint32_t seed) {
    uint8_t bytes[255];
    size_t length = fread(bytes, 1, sizeof bytes, stdin);
    printf("%" PRIu32 "\n", beamtouch_crc(bytes, (uint8_t)length, seed));
}

int main(int count, char **words) {
    const char *what = count > 1 ? words[1] : "";
    if (strcmp(what, "decode") == 0) {
        decode();
    } else if (strcmp(what, "encode") == 0) {
        encode();
    } else if (strcmp(what, "crc") == 0 && count > 2) {
        crc((uint32_t)strtoul(words[2], NULL, 10));
    } else if (strcmp(what, "constants") == 0) {
        printf("%d %" PRIu32 " %d\n", BEAMTOUCH_PROTOCOL_VERSION, BEAMTOUCH_SCHEMA_HASH, BEAMTOUCH_MAX_FRAME_BYTES);
    } else {
        return 2;
    }
    return 0;
}
