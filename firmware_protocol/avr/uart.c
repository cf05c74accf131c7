#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stddef.h>
#include <util/atomic.h>

#include "config.h"

/* Frames are encoded straight into one of these buffers while the interrupt sends another. One is always free. */
#define FRAMES 4
/* Room for the bytes that arrive while the main loop encodes a frame: 30 bytes in at most 300 us. */
#define RECEIVED_BYTES 64

#define RECEIVE_AND_SEND (_BV(RXCIE0) | _BV(RXEN0) | _BV(TXEN0))

static uint8_t frames[FRAMES][MAX_SENT_BYTES];
static uint8_t filling;          /* the frame to write next */
static volatile uint8_t sending; /* the frame on the line; none if equal to `filling` */
static const uint8_t *next;      /* its next byte */

static volatile uint8_t received[RECEIVED_BYTES];
static volatile uint8_t received_end;
static uint8_t received_begin;

void uart_start(void) {
    UCSR0A = _BV(U2X0); /* before the divider: simavr reads this bit only when the divider is set */
    UBRR0 = F_CPU / 8 / (10UL * LINE_BYTES_PER_S) - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = RECEIVE_AND_SEND;
    UDR0 = 0;
}

ISR(USART_RX_vect) {
    uint8_t byte = UDR0;
    uint8_t end = (received_end + 1) % RECEIVED_BYTES;
    if (end == received_begin) return; /* the buffer is full: the byte is lost, and the frame's checksum shows it */
    received[received_end] = byte;
    received_end = end;
}

bool uart_receive(uint8_t *byte) {
    if (received_begin == received_end) return false;
    *byte = received[received_begin];
    received_begin = (received_begin + 1) % RECEIVED_BYTES;
    return true;
}

static uint8_t after(uint8_t frame) { return (frame + 1) % FRAMES; }

uint8_t *uart_free_frame(void) { return after(filling) == sending ? NULL : frames[filling]; }

void uart_send(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (sending == filling) next = frames[filling];
        filling = after(filling);
        UCSR0B |= _BV(UDRIE0);
    }
}

/* Send one byte. The zero that ends a frame occurs nowhere inside it. Written by hand because it runs for every byte: it
 * takes 43 of the 160 cycles that a byte takes on the line. The compiler's version takes 66, too many at the highest rate.
 * After the zero all registers are restored, and the compiled part below finishes the frame and returns. */
ISR(USART_UDRE_vect, ISR_NAKED) {
    asm volatile("push r24 \n\t"
                 "in r24, %[sreg] \n\t"
                 "push r24 \n\t"
                 "push r30 \n\t"
                 "push r31 \n\t"
                 "lds r30, %[next] \n\t"
                 "lds r31, %[next]+1 \n\t"
                 "ld r24, Z+ \n\t"
                 "sts %[udr], r24 \n\t"
                 "sts %[next]+1, r31 \n\t"
                 "sts %[next], r30 \n\t"
                 "pop r31 \n\t"
                 "pop r30 \n\t"
                 "tst r24 \n\t"
                 "pop r24 \n\t"
                 "breq 1f \n\t"
                 "out %[sreg], r24 \n\t"
                 "pop r24 \n\t"
                 "reti \n\t"
                 "1: out %[sreg], r24 \n\t"
                 "pop r24 \n\t"
                 "jmp __vector_frame_sent" ::[next] "i"(&next),
                 [udr] "n"(_SFR_MEM_ADDR(UDR0)), [sreg] "I"(_SFR_IO_ADDR(SREG)));
}

/* The compiled part of the interrupt above. gcc requires the name of an interrupt to begin with __vector. */
__attribute__((signal, used)) void __vector_frame_sent(void);
void __vector_frame_sent(void) {
    uint8_t frame = after(sending);
    sending = frame;
    next = frames[frame];
    if (frame == filling) UCSR0B = RECEIVE_AND_SEND;
}
