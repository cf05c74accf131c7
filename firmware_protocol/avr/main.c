/* Reference firmware: an ATmega328P at 16 MHz that samples CHANNELS sensors and speaks the serial protocol. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <stddef.h>

#include "boot_id.h"
#include "clock.h"
#include "config.h"
#include "scan.h"
#include "uart.h"

static beamtouch_decoder decoder;
static uint32_t boot_id;
static beamtouch_message answer; /* type 0: no answer is due */

/* After a watchdog reset the watchdog still runs, with its shortest timeout: stop it before anything else. */
__attribute__((naked, used, section(".init3"))) void stop_watchdog(void) {
    MCUSR = 0;
    wdt_disable();
}

static void answer_hello(void) {
    answer.type = BEAMTOUCH_HELLO;
    answer.as.hello = (beamtouch_hello){
        .protocol_version = BEAMTOUCH_PROTOCOL_VERSION,
        .schema_hash = BEAMTOUCH_SCHEMA_HASH,
        .boot_id = boot_id,
        .channel_count = CHANNELS,
        .adc_bits = ADC_BITS,
        .max_rate_hz = MAX_RATE_HZ,
    };
}

static void handle(const beamtouch_message *message) {
    switch (message->type) {
    case BEAMTOUCH_HELLO_REQUEST:
        answer_hello();
        break;
    case BEAMTOUCH_PING:
        answer.type = BEAMTOUCH_PONG;
        answer.as.pong.token = message->as.ping.token;
        break;
    case BEAMTOUCH_IDENTIFY:
        identify(message->as.identify.seconds);
        break;
    case BEAMTOUCH_START:
        scan_start(message->as.start.rate_hz, message->as.start.oversampling);
        break;
    case BEAMTOUCH_STOP:
        scan_stop();
        break;
    }
}

/* Take one byte per round, so that a flood of bytes does not hold up the readings. A question waits until the one before
 * it is answered. */
static void listen(void) {
    uint8_t byte;
    beamtouch_message message;
    if (answer.type != 0 || !uart_receive(&byte)) return;
    if (beamtouch_decode(&decoder, byte, &message)) handle(&message);
}

/* Send a message; false if the transmit buffer is full. */
static bool send(const beamtouch_message *message) {
    uint8_t *frame = uart_free_frame();
    if (frame == NULL) return false;
    beamtouch_encode(message, frame);
    uart_send();
    return true;
}

static void send_answer(void) {
    if (answer.type == 0) return;
    if (answer.type == BEAMTOUCH_PONG) answer.as.pong.device_us = clock_us();
    if (send(&answer)) answer.type = 0;
}

static void send_reading(void) {
    const beamtouch_message *reading = scan_waiting();
    if (reading != NULL && send(reading)) scan_forget();
}

int main(void) {
    boot_id = next_boot_id();
    clock_start();
    scan_prepare();
    uart_start();
    answer_hello();
    wdt_enable(WDTO_250MS);
    sei();
    for (;;) {
        wdt_reset();
        listen();
        send_answer();
        send_reading();
    }
}
