/* SPDX-License-Identifier: MIT */
/* safe_text.h: text of files, and names of files, on its way to a terminal. It may hold any bytes; none of
 * them may move the cursor, make lines or look like another line of ours. */
#ifndef BTF_TOOLS_SAFE_TEXT_H
#define BTF_TOOLS_SAFE_TEXT_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

/* Bytes of the UTF-8 sequence at the start of the text and its code point; 0 if it is none. */
int safe_text_character(const char *text, uint32_t *code);
/* Controls (C0, DEL and C1), separators of lines and paragraphs, and marks that change the direction of
 * writing. */
bool safe_text_is_control(uint32_t code);

/* Prints the text with '?' for every control and every byte that is no UTF-8; returns how many characters
 * that were. NULL prints nothing. */
int safe_text_put(FILE *out, const char *text);
/* Does the same to the text where it stands. */
void safe_text_clean(char *text);

#endif
