#include "scan.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stddef.h>
#include <util/atomic.h>

#include "clock.h"
#include "config.h"

#if MAX_RATE_HZ * (CHANNELS * CONVERSION_US + SCAN_OVERHEAD_US) > 1000000
#error "MAX_RATE_HZ is faster than the ADC can scan"
#endif

#define REFERENCE _BV(REFS0) /* AVCC, with a capacitor at AREF */
#define CONVERT (_BV(ADEN) | _BV(ADSC) | _BV(ADIE) | ADC_PRESCALER_BITS)
#define FIRST_SCAN_TICKS 500 /* delay after Start, longer than a conversion that may still be running */
#define LONGEST_STEP 0x8000

/* The schedule. The period is rarely a whole number of ticks: the remainder accumulates until it makes one more tick, so
 * that the rate is exact in the long run. */
static uint16_t rate;
static uint32_t period_ticks;
static uint16_t period_rest; /* in ticks / rate */
static uint16_t rest_sum;
static uint32_t ticks_to_go;

/* The interrupts fill one reading while others wait to be sent. Several may wait, because answers go first, and three
 * answers in a row take as long as some readings. */
#define READINGS 8
static beamtouch_message readings[READINGS];
static uint16_t scan_ticks[READINGS]; /* duration of each scan */
static volatile uint8_t filling;
static volatile uint8_t waiting; /* the first reading to send; none if equal to `filling` */

/* The running scan. */
static volatile bool is_scanning;
static uint16_t began_ticks;
static uint8_t scan_oversampling;
static uint8_t rounds_left;
static uint8_t channel;
static uint16_t *sum; /* the count of `channel` in the reading */
static uint16_t sequence;

static void convert(uint8_t which) {
    ADMUX = REFERENCE | which;
    ADCSRA = CONVERT;
}

void scan_prepare(void) {
    DIDR0 = (uint8_t)((1U << CHANNELS) - 1); /* the pins' digital inputs would add noise */
    convert(0);                              /* the first conversion takes longer; its result is not used */
}

static bool can_keep(uint16_t rate_hz, uint8_t oversampling) {
    return rate_hz >= 1 && rate_hz <= MAX_RATE_HZ && oversampling >= 1 && oversampling <= MAX_OVERSAMPLING &&
           rate_hz * SCAN_US(oversampling) <= 1000000;
}

bool scan_start(uint16_t rate_hz, uint8_t oversampling) {
    if (!can_keep(rate_hz, oversampling)) return false;
    uint32_t ticks = TICKS_PER_S / rate_hz;
    uint16_t rest = TICKS_PER_S % rate_hz;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        is_scanning = false;
        rate = rate_hz;
        period_ticks = ticks;
        period_rest = rest;
        rest_sum = 0;
        ticks_to_go = 0;
        scan_oversampling = oversampling;
        OCR1A = TCNT1 + FIRST_SCAN_TICKS;
        TIFR1 = _BV(OCF1A); /* clear an old match */
        TIMSK1 |= _BV(OCIE1A);
    }
    return true;
}

void scan_stop(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        TIMSK1 &= (uint8_t)~_BV(OCIE1A);
        is_scanning = false;
        waiting = filling;
    }
}

static uint8_t after(uint8_t reading) { return (reading + 1) % READINGS; }

const beamtouch_message *scan_waiting(void) {
    uint8_t first = waiting;
    if (first == filling) return NULL;
    asm volatile("" ::: "memory"); /* keep the compiler from reading the contents before `filling` */
    beamtouch_message *message = &readings[first];
    message->as.reading.device_us += scan_ticks[first] / (2 * TICKS_PER_US); /* move the time to the scan's middle, once */
    scan_ticks[first] = 0;
    return message;
}

void scan_forget(void) { waiting = after(waiting); }

static void begin_scan(void) {
    if (is_scanning) { /* never at the accepted rates; if it happens, the gap in `sequence` shows the loss */
        ATOMIC_BLOCK(ATOMIC_FORCEON) { sequence++; }
        return;
    }
    beamtouch_message *message = &readings[filling];
    beamtouch_reading *reading = &message->as.reading;
    message->type = BEAMTOUCH_READING;
    reading->sequence = sequence;
    ATOMIC_BLOCK(ATOMIC_FORCEON) {
        reading->device_us = clock_us_locked();
        began_ticks = TCNT1;
    }
    reading->oversampling = scan_oversampling;
    reading->channel_count = CHANNELS;
    for (uint8_t i = 0; i < CHANNELS; i++) reading->counts[i] = 0;
    rounds_left = scan_oversampling;
    channel = 0;
    sum = reading->counts;
    is_scanning = true;
    convert(0);
}

/* Interruptible, because the line must not wait for its next byte. It ends long before it is due again. */
ISR(TIMER1_COMPA_vect, ISR_NOBLOCK) {
    if (ticks_to_go == 0) {
        begin_scan();
        ticks_to_go = period_ticks;
        rest_sum += period_rest;
        if (rest_sum >= rate) {
            rest_sum -= rate;
            ticks_to_go++;
        }
    }
    /* A long period is split into steps that fit the compare unit; the last step is never short. */
    uint16_t step = ticks_to_go > 0xFFFF ? LONGEST_STEP : (uint16_t)ticks_to_go;
    ticks_to_go -= step;
    ATOMIC_BLOCK(ATOMIC_FORCEON) { OCR1A += step; } /* 16-bit access goes through a register that TCNT1 shares */
}

static void finish_scan(void) {
    uint8_t following = after(filling);
    is_scanning = false;
    sequence++;
    if (following == waiting) return; /* the buffer is full: drop this reading; its number stays used */
    scan_ticks[filling] = TCNT1 - began_ticks; /* 16 ms at most */
    filling = following;
}

/* Convert all channels once, then all again, so that every sum covers the same time. This runs most often, so it is
 * short: arithmetic beyond 16 bits is done before or after the scan. */
ISR(ADC_vect) {
    if (!is_scanning) return; /* stopped in the meantime */
    /* Read before choosing the next channel: simavr computes the conversion when ADC is read. Hardware would not mind. */
    *sum++ += ADC;
    uint8_t following = channel + 1;
    if (following == CHANNELS) {
        following = 0;
        sum -= CHANNELS;
        if (--rounds_left == 0) {
            finish_scan();
            return;
        }
    }
    channel = following;
    convert(following);
}
