/* SPDX-License-Identifier: MIT */
/* cli_session.h: set-up of the process, for main.c. */
#ifndef BTF_TOOLS_CLI_SESSION_H
#define BTF_TOOLS_CLI_SESSION_H

/* Signal handlers. */
void cli_session_begin(void);

#endif
