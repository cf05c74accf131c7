/* The Beamtouch serial protocol, version 1, for both sides: messages to frames and frames to messages.
 *
 * ../PROTOCOL.md says what the messages mean. Pure C99: no heap, no floating point, no I/O, nothing static that changes.
 *
 * A device that has little memory defines, for this header and beamtouch_protocol.c alike:
 *   BEAMTOUCH_MOST_FRAME_BYTES  the longest frame that its decoder takes; 10 is all that a device is sent
 *   BEAMTOUCH_MOST_CHANNELS     the most counts that a reading holds
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

/* Length of the frame of a reading or of a hello, with its delimiter: what a transmit buffer must hold. */
#define BEAMTOUCH_READING_FRAME_BYTES(channels) (14 + 2 * (channels))
#define BEAMTOUCH_HELLO_FRAME_BYTES 20

#ifndef BEAMTOUCH_MOST_CHANNELS
#define BEAMTOUCH_MOST_CHANNELS 32
#endif
#ifndef BEAMTOUCH_MOST_FRAME_BYTES
#define BEAMTOUCH_MOST_FRAME_BYTES BEAMTOUCH_READING_FRAME_BYTES(BEAMTOUCH_MOST_CHANNELS)
#endif
#if BEAMTOUCH_MOST_CHANNELS < 1 || BEAMTOUCH_MOST_CHANNELS > 32
#error "a reading has 1 to 32 channels"
#endif
#if BEAMTOUCH_MOST_FRAME_BYTES < 10 || BEAMTOUCH_MOST_FRAME_BYTES > 78
#error "the longest frame has 10 bytes to a device, 78 to a host"
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
    uint8_t channel_count; /* of `counts`; on the line it follows from the length */
    uint16_t counts[BEAMTOUCH_MOST_CHANNELS];
} beamtouch_reading;

/* One message of any type; `as` says nothing for HelloRequest and Stop. */
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

/* Why a frame was not taken, as PROTOCOL.md names it. */
enum {
    BEAMTOUCH_OVERLONG,
    BEAMTOUCH_COBS,
    BEAMTOUCH_LENGTH,
    BEAMTOUCH_CRC,
    BEAMTOUCH_TYPE,
    BEAMTOUCH_REJECTIONS
};

/* What stands of the frame that is arriving. All zeros is a decoder that has seen nothing. */
typedef struct {
    uint32_t frames;                         /* that became a message */
    uint32_t rejected[BEAMTOUCH_REJECTIONS]; /* that did not, by reason */
    uint8_t length;
    bool skipping; /* an overlong frame, up to the next delimiter */
    uint8_t frame[BEAMTOUCH_MOST_FRAME_BYTES - 1];
} beamtouch_decoder;

/* Write the whole frame of a message with its delimiter; returns its length, or 0 if the type or the number of
 * channels is none that the protocol has. `frame` must hold it. */
uint8_t beamtouch_encode(const beamtouch_message *message, uint8_t *frame);

/* Take one byte from the line; true if a message is complete with it. Never fails, whatever comes. */
bool beamtouch_decode(beamtouch_decoder *decoder, uint8_t byte, beamtouch_message *message);

/* CRC-32 with a seed, as the checksum of a frame. */
uint32_t beamtouch_crc(const uint8_t *body, uint8_t length, uint32_t seed);

#ifdef __cplusplus
}
#endif

#endif
