// Stands in for a header of Boost of which nothing is used.
#pragma once
