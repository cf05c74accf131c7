/* What a build is made for, and what follows from it. */
#ifndef CONFIG_H
#define CONFIG_H

#include "beamtouch_protocol.h"

/* ADC0 and up. A chip in a DIP-28 case has six, the others eight. */
#ifndef CHANNELS
#define CHANNELS 4
#endif
#if CHANNELS < 1 || CHANNELS > 8
#error "CHANNELS must be 1 to 8"
#endif

/* The timer counts half microseconds, and the line takes ten microseconds a byte: both want 16 MHz. */
#if F_CPU != 16000000
#error "the clock must be 16 MHz"
#endif

#define ADC_BITS 10
#define MOST_OVERSAMPLING 64 /* 64 times 1023 still fits into 16 bits, 65 times does not */

/* ADC clock 16 MHz / 32 = 500 kHz. The data sheet promises full accuracy up to 200 kHz and allows 1 MHz; the slow one
 * cannot keep the rates below, and the fast one costs accuracy for rates that the line could not carry anyway. */
#define ADC_PRESCALER_BITS (_BV(ADPS2) | _BV(ADPS0))

/* A conversion takes 13 ADC clocks, 26 us. To that come up to one clock until it starts, and the interrupt that reads it,
 * which may have to wait for another. What a scan may take besides, it takes once. */
#define CONVERSION_US 32
#define SCAN_OVERHEAD_US 40
#define SCAN_US(oversampling) ((uint32_t)(oversampling) * (CHANNELS * CONVERSION_US) + SCAN_OVERHEAD_US)

/* Nine tenths of what the line carries: the rest is for answers and for the tolerance of the clocks. */
#define LINE_BYTES_PER_S 100000
#define MAX_RATE_HZ (LINE_BYTES_PER_S / 10 * 9 / BEAMTOUCH_READING_FRAME_BYTES(CHANNELS))
#define LARGEST(a, b) ((a) > (b) ? (a) : (b))
#define MOST_SENT_BYTES LARGEST(BEAMTOUCH_READING_FRAME_BYTES(CHANNELS), BEAMTOUCH_HELLO_FRAME_BYTES)

#endif
