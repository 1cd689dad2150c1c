/* SPDX-License-Identifier: MIT */
/* images_hostile.h: archives and folders that must be refused. */
#ifndef BTF_FORMATS_IMAGES_HOSTILE_H
#define BTF_FORMATS_IMAGES_HOSTILE_H

void test_hostile_archives(void **state); /* when they are opened */
void test_hostile_pictures(void **state); /* when the damaged picture is read */
void test_truncation(void **state);
void test_duplicates(void **state);
void test_odd_folders(void **state);
void test_count_refusals(void **state); /* behind the others */

#endif
