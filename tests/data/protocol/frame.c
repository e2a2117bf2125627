/* Prints the frame of a `Bye`, by r4.h and docs/protocol.md alone. */
#include "r4.h"

#include <stdio.h>

int main(void)
{
    unsigned char message[5] = {R4_TO_DEVICE_REQUEST, 3, R4_REQUEST_BYE};
    unsigned char frame[7] = {0};
    unsigned long sum = R4_CRC16_INITIAL;
    unsigned at, code = 0;

    for (at = 0; at < 3; at++) {
        int bit;
        sum ^= message[at];
        for (bit = 0; bit < 8; bit++)
            sum = sum & 1 ? sum >> 1 ^ R4_CRC16_REFLECTED : sum >> 1;
    }
    sum ^= R4_CRC16_FINAL_XOR;
    message[3] = sum & 0xff;
    message[4] = sum >> 8 & 0xff;

    /* COBS: each piece between zeros behind its length plus 1. */
    for (at = 0; at < 5; at++) {
        frame[at + 1] = message[at];
        if (message[at] == 0) {
            frame[code] = (unsigned char)(at + 1 - code);
            code = at + 1;
        }
    }
    frame[code] = (unsigned char)(6 - code);

    for (at = 0; at < sizeof frame; at++)
        printf("%02x", frame[at]);
    return 0;
}
