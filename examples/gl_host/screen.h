/* SPDX-License-Identifier: MIT */
/* screen.h: where gl_host.c draws with OpenGL ES 3: a picture in memory, or a window. Functions return NULL
 * when done, and otherwise what is wrong. */
#ifndef EXAMPLE_SCREEN_H
#define EXAMPLE_SCREEN_H

enum { SCREEN_SIDE = 512 };

const char *screen_open_picture(void);
const char *screen_save_picture(const char *png_path);

/* Only builds that found GLFW have windows. */
const char *screen_open_window(void);
/* Shows what was drawn and waits for the user. Where the cursor is then, from -1 to 1 to the right and up; 0
 * = the window was closed. */
int screen_show(float *right, float *up);

void screen_close(void);

#endif
