/* The Beamtouch serial protocol, version 1: encodes and decodes messages, for devices and hosts.
 *
 * ../PROTOCOL.md says what the messages mean. Pure C99: no heap, no floating point, no I/O, no mutable static data.
 *
 * To save memory, a device may define these for both this header and beamtouch_protocol.c:
 *   BEAMTOUCH_MAX_FRAME_BYTES  longest frame that the decoder accepts; a device receives no frame longer than 10
 *   BEAMTOUCH_MAX_CHANNELS     largest number of counts in a reading
 */
#ifndef BEAMTOUCH_PROTOCOL_H
#define BEAMTOUCH_PROTOCOL_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define BEAMTOUCH_PROTOCOL_VERSION 1
#define BEAMTOUCH_SCHEMA_HASH 0x3D4A3321u

/* Length of a reading's and of a Hello's frame, with the delimiter. A transmit buffer must hold the longer of the two. */
#define BEAMTOUCH_READING_FRAME_BYTES(channels) (14 + 2 * (channels))
#define BEAMTOUCH_HELLO_FRAME_BYTES 20

#ifndef BEAMTOUCH_MAX_CHANNELS
#define BEAMTOUCH_MAX_CHANNELS 32
#endif
#ifndef BEAMTOUCH_MAX_FRAME_BYTES
#define BEAMTOUCH_MAX_FRAME_BYTES BEAMTOUCH_READING_FRAME_BYTES(BEAMTOUCH_MAX_CHANNELS)
#endif
#if BEAMTOUCH_MAX_CHANNELS < 1 || BEAMTOUCH_MAX_CHANNELS > 32
#error "BEAMTOUCH_MAX_CHANNELS must be 1 to 32"
#endif
#if BEAMTOUCH_MAX_FRAME_BYTES < 10 || BEAMTOUCH_MAX_FRAME_BYTES > 78
#error "BEAMTOUCH_MAX_FRAME_BYTES must be 10 (device) to 78 (host)"
#endif

enum {
    BEAMTOUCH_HELLO_REQUEST = 0x01,
    BEAMTOUCH_PING = 0x02,
    BEAMTOUCH_IDENTIFY = 0x03,
    BEAMTOUCH_START = 0x10,
    BEAMTOUCH_STOP = 0x11,
    BEAMTOUCH_HELLO = 0x81,
    BEAMTOUCH_PONG = 0x82,
    BEAMTOUCH_READING = 0x90
};

typedef struct {
    uint16_t token;
} beamtouch_ping;

typedef struct {
    uint8_t seconds;
} beamtouch_identify;

typedef struct {
    uint16_t rate_hz;
    uint8_t oversampling;
} beamtouch_start;

typedef struct {
    uint8_t protocol_version;
    uint32_t schema_hash;
    uint32_t boot_id;
    uint8_t channel_count;
    uint8_t adc_bits;
    uint16_t max_rate_hz;
} beamtouch_hello;

typedef struct {
    uint16_t token;
    uint32_t device_us;
} beamtouch_pong;

typedef struct {
    uint16_t sequence;
    uint32_t device_us;
    uint8_t oversampling;
    uint8_t channel_count; /* length of `counts`; not sent, it follows from the payload's length */
    uint16_t counts[BEAMTOUCH_MAX_CHANNELS];
} beamtouch_reading;

/* One message of any type; HelloRequest and Stop leave `as` unused. */
typedef struct {
    uint8_t type;
    union {
        beamtouch_ping ping;
        beamtouch_identify identify;
        beamtouch_start start;
        beamtouch_hello hello;
        beamtouch_pong pong;
        beamtouch_reading reading;
    } as;
} beamtouch_message;

/* Reasons to reject a frame, with the names of PROTOCOL.md. */
enum {
    BEAMTOUCH_OVERLONG,
    BEAMTOUCH_COBS,
    BEAMTOUCH_LENGTH,
    BEAMTOUCH_CRC,
    BEAMTOUCH_TYPE,
    BEAMTOUCH_REJECTIONS
};

/* The state of a decoder. Initialise it with all zeros. */
typedef struct {
    uint32_t frames;                         /* decoded to a message */
    uint32_t rejected[BEAMTOUCH_REJECTIONS]; /* rejected, by reason */
    uint8_t length;
    bool skipping; /* dropping an overlong frame up to the next delimiter */
    uint8_t frame[BEAMTOUCH_MAX_FRAME_BYTES - 1];
} beamtouch_decoder;

/* Write the whole frame of a message with its delimiter and return its length; 0 if the protocol has no such type or
 * number of channels. `frame` must be large enough. */
uint8_t beamtouch_encode(const beamtouch_message *message, uint8_t *frame);

/* Take one byte from the line; true if it completes a message. Accepts any input. */
bool beamtouch_decode(beamtouch_decoder *decoder, uint8_t byte, beamtouch_message *message);

/* The checksum of a frame: CRC-32 with a seed. */
uint32_t beamtouch_crc(const uint8_t *body, uint8_t length, uint32_t seed);

#ifdef __cplusplus
}
#endif

#endif
