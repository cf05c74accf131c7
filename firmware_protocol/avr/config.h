/* Build settings, and the constants derived from them. */
#ifndef CONFIG_H
#define CONFIG_H

#include "beamtouch_protocol.h"

/* Sensors at ADC0 and up. The chip in a DIP-28 case has six inputs, in other cases eight. */
#ifndef CHANNELS
#define CHANNELS 4
#endif
#if CHANNELS < 1 || CHANNELS > 8
#error "CHANNELS must be 1 to 8"
#endif

/* The timer counts half microseconds and the line sends a byte in ten microseconds: both need 16 MHz. */
#if F_CPU != 16000000
#error "the clock must be 16 MHz"
#endif

#define ADC_BITS 10
#define MAX_OVERSAMPLING 64 /* 64 times 1023 still fits into 16 bits, 65 times does not */

/* ADC clock 16 MHz / 32 = 500 kHz. The data sheet promises full accuracy up to 200 kHz and allows 1 MHz. 200 kHz is too
 * slow for the rates below; 1 MHz costs accuracy, for rates that the line could not carry anyway. */
#define ADC_PRESCALER_BITS (_BV(ADPS2) | _BV(ADPS0))

/* A conversion takes 13 ADC clocks, 26 us. It starts up to one clock late, and the interrupt that reads it may wait for
 * another interrupt: 32 us in all. The overhead occurs once per scan. */
#define CONVERSION_US 32
#define SCAN_OVERHEAD_US 40
#define SCAN_US(oversampling) ((uint32_t)(oversampling) * (CHANNELS * CONVERSION_US) + SCAN_OVERHEAD_US)

/* Readings use nine tenths of the line; the rest is for answers and for the tolerance of the clocks. */
#define LINE_BYTES_PER_S 100000
#define MAX_RATE_HZ (LINE_BYTES_PER_S / 10 * 9 / BEAMTOUCH_READING_FRAME_BYTES(CHANNELS))
#define LARGEST(a, b) ((a) > (b) ? (a) : (b))
#define MAX_SENT_BYTES LARGEST(BEAMTOUCH_READING_FRAME_BYTES(CHANNELS), BEAMTOUCH_HELLO_FRAME_BYTES)

#endif
