#include "beamtouch_protocol.h"

#include <string.h>

enum { CRC_BYTES = 4, TYPE_BYTES = 1, FIXED_READING_BYTES = 7 };

/* The usual CRC table of 256 remainders is linear: the remainder of a byte is that of its low nibble XOR that of its high
 * nibble. So 128 bytes of table give nearly the speed of 1024. On AVR the table lies in flash. */
#ifdef __AVR__
#include <avr/pgmspace.h>
#define IN_FLASH PROGMEM
#define ENTRY(table, index) pgm_read_dword((const uint8_t *)(table) + (uint8_t)((index) * 4u)) /* the offset fits 8 bits */
#else
#define IN_FLASH
#define ENTRY(table, index) ((table)[index])
#endif

static const uint32_t low_nibble[16] IN_FLASH = {
    0x00000000u, 0x77073096u, 0xEE0E612Cu, 0x990951BAu, 0x076DC419u, 0x706AF48Fu, 0xE963A535u, 0x9E6495A3u,
    0x0EDB8832u, 0x79DCB8A4u, 0xE0D5E91Eu, 0x97D2D988u, 0x09B64C2Bu, 0x7EB17CBDu, 0xE7B82D07u, 0x90BF1D91u,
};

static const uint32_t high_nibble[16] IN_FLASH = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
    0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

uint32_t beamtouch_crc(const uint8_t *body, uint8_t length, uint32_t seed) {
    uint32_t crc = ~seed;
    while (length--) {
        uint8_t low = (uint8_t)crc ^ *body++;
        crc = (crc >> 8) ^ ENTRY(low_nibble, low & 15) ^ ENTRY(high_nibble, low >> 4);
    }
    return ~crc;
}

/* HelloRequest and Hello are readable across versions; the schema hash protects everything else. */
static uint32_t seed_of(uint8_t type) {
    return type == BEAMTOUCH_HELLO_REQUEST || type == BEAMTOUCH_HELLO ? 0 : BEAMTOUCH_SCHEMA_HASH;
}

static uint8_t *put_u16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put_u32(uint8_t *at, uint32_t value) {
    return put_u16(put_u16(at, (uint16_t)value), (uint16_t)(value >> 16));
}

static uint16_t get_u16(const uint8_t *at) { return (uint16_t)(at[0] | (uint16_t)at[1] << 8); }

static uint32_t get_u32(const uint8_t *at) { return get_u16(at) | (uint32_t)get_u16(at + 2) << 16; }

static uint8_t *put_hello(uint8_t *at, const beamtouch_hello *hello) {
    *at++ = hello->protocol_version;
    at = put_u32(put_u32(at, hello->schema_hash), hello->boot_id);
    *at++ = hello->channel_count;
    *at++ = hello->adc_bits;
    return put_u16(at, hello->max_rate_hz);
}

static void get_hello(const uint8_t *at, beamtouch_hello *hello) {
    hello->protocol_version = at[0];
    hello->schema_hash = get_u32(at + 1);
    hello->boot_id = get_u32(at + 5);
    hello->channel_count = at[9];
    hello->adc_bits = at[10];
    hello->max_rate_hz = get_u16(at + 11);
}

static uint8_t *put_reading(uint8_t *at, const beamtouch_reading *reading) {
    if (reading->channel_count < 1 || reading->channel_count > BEAMTOUCH_MAX_CHANNELS) return NULL;
    at = put_u32(put_u16(at, reading->sequence), reading->device_us);
    *at++ = reading->oversampling;
    for (uint8_t channel = 0; channel < reading->channel_count; channel++) {
        at = put_u16(at, reading->counts[channel]);
    }
    return at;
}

/* Read the payload of a reading; false if no reading has this length. */
static bool get_reading(const uint8_t *at, uint8_t length, beamtouch_reading *reading) {
    if (length <= FIXED_READING_BYTES || (length - FIXED_READING_BYTES) % 2 != 0) return false;
    reading->channel_count = (uint8_t)(length - FIXED_READING_BYTES) / 2;
    if (reading->channel_count > BEAMTOUCH_MAX_CHANNELS) return false;
    reading->sequence = get_u16(at);
    reading->device_us = get_u32(at + 2);
    reading->oversampling = at[6];
    at += FIXED_READING_BYTES;
    for (uint8_t channel = 0; channel < reading->channel_count; channel++, at += 2) {
        reading->counts[channel] = get_u16(at);
    }
    return true;
}

/* Write the payload; returns its end, or NULL if there is no such message. */
static uint8_t *put_payload(uint8_t *at, const beamtouch_message *message) {
    switch (message->type) {
    case BEAMTOUCH_HELLO_REQUEST:
    case BEAMTOUCH_STOP:
        return at;
    case BEAMTOUCH_PING:
        return put_u16(at, message->as.ping.token);
    case BEAMTOUCH_IDENTIFY:
        *at = message->as.identify.seconds;
        return at + 1;
    case BEAMTOUCH_START:
        at = put_u16(at, message->as.start.rate_hz);
        *at = message->as.start.oversampling;
        return at + 1;
    case BEAMTOUCH_HELLO:
        return put_hello(at, &message->as.hello);
    case BEAMTOUCH_PONG:
        return put_u32(put_u16(at, message->as.pong.token), message->as.pong.device_us);
    case BEAMTOUCH_READING:
        return put_reading(at, &message->as.reading);
    default:
        return NULL;
    }
}

/* Read a payload of any length; returns BEAMTOUCH_REJECTIONS if it is valid, otherwise the reason for its rejection. */
static uint8_t get_payload(const uint8_t *at, uint8_t length, beamtouch_message *message) {
    bool fits = length == 0;
    switch (message->type) {
    case BEAMTOUCH_HELLO_REQUEST:
    case BEAMTOUCH_STOP:
        break;
    case BEAMTOUCH_PING:
        fits = length == 2;
        if (fits) message->as.ping.token = get_u16(at);
        break;
    case BEAMTOUCH_IDENTIFY:
        fits = length == 1;
        if (fits) message->as.identify.seconds = at[0];
        break;
    case BEAMTOUCH_START:
        fits = length == 3;
        if (fits) message->as.start = (beamtouch_start){get_u16(at), at[2]};
        break;
    case BEAMTOUCH_HELLO:
        fits = length == 13;
        if (fits) get_hello(at, &message->as.hello);
        break;
    case BEAMTOUCH_PONG:
        fits = length == 6;
        if (fits) message->as.pong = (beamtouch_pong){get_u16(at), get_u32(at + 2)};
        break;
    case BEAMTOUCH_READING:
        fits = get_reading(at, length, &message->as.reading);
        break;
    default:
        return BEAMTOUCH_TYPE;
    }
    return fits ? BEAMTOUCH_REJECTIONS : BEAMTOUCH_LENGTH;
}

/* Encode COBS in place: the content follows one free byte. That byte and each zero become the distance to the next zero;
 * the delimiter is the last zero. No frame is long enough for the rule on pieces of 254 bytes. */
static void stuff(uint8_t *frame, uint8_t *delimiter) {
    uint8_t distance = 1;
    for (uint8_t *at = delimiter - 1; at > frame; at--) {
        if (*at == 0) {
            *at = distance;
            distance = 0;
        }
        distance++;
    }
    *frame = distance;
    *delimiter = 0;
}

/* Decode COBS in place: the content then follows the first byte. False if a distance leads beyond the end. */
static bool unstuff(uint8_t *frame, uint8_t length) {
    uint8_t at = 0;
    uint8_t distance = frame[0];
    while (distance < length - at) {
        at += distance;
        distance = frame[at];
        frame[at] = 0;
    }
    return distance == length - at;
}

uint8_t beamtouch_encode(const beamtouch_message *message, uint8_t *frame) {
    uint8_t *body = frame + 1;
    uint8_t *end = put_payload(body + TYPE_BYTES, message);
    if (end == NULL) return 0;
    *body = message->type;
    end = put_u32(end, beamtouch_crc(body, (uint8_t)(end - body), seed_of(message->type)));
    stuff(frame, end);
    return (uint8_t)(end + 1 - frame);
}

/* Decode a complete frame; returns the same as get_payload. */
static uint8_t open_frame(uint8_t *frame, uint8_t length, beamtouch_message *message) {
    uint8_t *body = frame + 1;
    if (!unstuff(frame, length)) return BEAMTOUCH_COBS;
    if (length < 1 + TYPE_BYTES + CRC_BYTES) return BEAMTOUCH_LENGTH;
    length -= 1 + CRC_BYTES;
    message->type = *body;
    if (get_u32(body + length) != beamtouch_crc(body, length, seed_of(*body))) return BEAMTOUCH_CRC;
    return get_payload(body + TYPE_BYTES, length - TYPE_BYTES, message);
}

static bool finish(beamtouch_decoder *decoder, beamtouch_message *message) {
    uint8_t length = decoder->length;
    decoder->length = 0;
    decoder->skipping = false;
    if (length == 0) return false;
    uint8_t result = open_frame(decoder->frame, length, message);
    if (result != BEAMTOUCH_REJECTIONS) {
        decoder->rejected[result]++;
        return false;
    }
    decoder->frames++;
    return true;
}

bool beamtouch_decode(beamtouch_decoder *decoder, uint8_t byte, beamtouch_message *message) {
    if (byte == 0) return finish(decoder, message);
    if (decoder->skipping) return false;
    if (decoder->length == sizeof decoder->frame) {
        decoder->skipping = true;
        decoder->length = 0;
        decoder->rejected[BEAMTOUCH_OVERLONG]++;
        return false;
    }
    decoder->frame[decoder->length++] = byte;
    return false;
}
