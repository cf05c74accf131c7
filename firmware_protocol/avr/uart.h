/* The line: 1 000 000 baud, 8N1, by interrupts in both directions. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

/* Open the line and end what stood on it. */
void uart_start(void);

/* The next byte that has arrived; false if there is none. */
bool uart_receive(uint8_t *byte);

/* Where the next frame is to be written; NULL if the transmit buffer is full. */
uint8_t *uart_free_frame(void);

/* Send the frame that was written there, up to its delimiter. */
void uart_send(void);

#endif
