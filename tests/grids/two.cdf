 04/26/09 IEEE                 100.0  2009 S TESIS
BUS DATA FOLLOWS                    2 ITEMS
   1 BUS-1   100   1  1  3 1.04  0.     0.       0.        71.6410227.04592 100.    1.04   999900 -99990    0.      0.        0
   2 BUS-2   100   1  1  0 1.025 -2.216 50.      10.       0.      0.       100.    1.       0.     0.      0.      0.        0
-999
BRANCH DATA FOLLOWS                    1 ITEMS
   1    2  1  1      0.01      0.085       0.176  0    0     0      0    0  0      0      0      0       0      0      0
-999
LOSS ZONES FOLLOWS   0 ITEMS
-99
INTERCHANGE DATA FOLLOWS      0 ITEMS
-9
TIE LINES FOLLOWS             0 ITEMS
-999
END OF DATA
